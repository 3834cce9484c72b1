// What stands around an arm, as outlines: boxes by their edges, walls as squares of a grid, the height of the floor.

const EDGES = [[0, 1], [1, 3], [3, 2], [2, 0], [4, 5], [5, 7], [7, 6], [6, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const LINES = [-1, -0.5, 0, 0.5, 1];

/** { floor (m or null), outlines: [[point, point]] } of the surroundings of a design; walls reach as far as `reach` (m). */
export function outlinesOf(surroundings, reach) {
  const boxes = (surroundings?.boxes ?? []).flatMap(edges);
  const walls = (surroundings?.walls ?? []).flatMap((wall) => grid(wall, reach));
  return { floor: surroundings?.floor ?? null, outlines: [...boxes, ...walls] };
}

function edges({ center, size, rpy = [0, 0, 0] }) {
  const turned = turnedBy(rpy);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [k & 1, (k >> 1) & 1, k >> 2].map((side, axis) => (side - 0.5) * size[axis]));
  const there = corners.map((corner) => turned(corner).map((value, axis) => value + center[axis]));
  return EDGES.map(([a, b]) => [there[a], there[b]]);
}

/** Roll, pitch, yaw about the fixed axes x, y, z, in this order, as in a URDF. */
function turnedBy([roll, pitch, yaw]) {
  const [cr, sr, cp, sp, cy, sy] = [roll, pitch, yaw].flatMap((angle) => [Math.cos(angle), Math.sin(angle)]);
  const rows = [
    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
    [-sp, cp * sr, cp * cr],
  ];
  return (point) => rows.map((row) => row.reduce((sum, value, k) => sum + value * point[k], 0));
}

function grid({ point, normal }, reach) {
  const [u, v] = within(normal);
  const at = (a, b) => point.map((value, k) => value + reach * (a * u[k] + b * v[k]));
  return LINES.flatMap((k) => [[at(k, -1), at(k, 1)], [at(-1, k), at(1, k)]]);
}

/** Two directions of a plane, at right angles. */
function within(normal) {
  const n = unit(normal);
  const helper = [0, 0, 0].map((_, k) => Number(k === n.map(Math.abs).indexOf(Math.min(...n.map(Math.abs)))));
  const u = unit(cross(n, helper));
  return [u, cross(n, u)];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(vector) {
  const length = Math.hypot(...vector);
  return vector.map((value) => value / length);
}

// Outlines of surroundings: edges of boxes, grids of walls.

const LINES = [-1, -0.5, 0, 0.5, 1];

/** [[point, point]] of what GET /v1/designs/{id}/clearances has of the surroundings; walls reach as far as `reach` (m). */
export function outlinesOf({ edges, walls }, reach) {
  return [...edges, ...walls.flatMap((wall) => grid(wall, reach))];
}

function grid({ point, along: [u, v] }, reach) {
  const at = (a, b) => point.map((value, k) => value + reach * (a * u[k] + b * v[k]));
  return LINES.flatMap((k) => [[at(k, -1), at(k, 1)], [at(-1, k), at(1, k)]]);
}

// Forward kinematics from the geometry that the API gives (GET /v1/robots/{id}/geometry): where every link is.

/** A pose is 12 numbers, row by row: the rotation beside the origin. */
export const BASE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

/**
 * Poses of all frames in the base frame at the positions of the robot's joints, and of its passive ones behind them;
 * null for what moves with a passive position that is not there.
 */
export function framesAt(geometry, positions) {
  const found = [];
  for (const frame of geometry.frames) {
    const parent = frame.parent === null ? BASE : found[frame.parent];
    if (!parent || frame.ratios.slice(positions.length).some(Boolean)) {
      found.push(null);
      continue;
    }
    const position = positions.reduce((sum, value, place) => sum + frame.ratios[place] * value, frame.offset);
    found.push(times(times(parent, flat(frame.placement)), motion(frame, position)));
  }
  return found;
}

/** A point of a frame in the base frame. */
export function placed(pose, [x, y, z]) {
  return [0, 4, 8].map((row) => pose[row] * x + pose[row + 1] * y + pose[row + 2] * z + pose[row + 3]);
}

/** The triangles of the robot's meshes at these frames: of each mesh { points, triangles }, in the base frame. */
export function surfacesAt(geometry, frames) {
  return geometry.surfaces.flatMap(({ frame, points, triangles }) => {
    const pose = frame === null ? BASE : frames[frame];
    return pose ? [{ points: points.map((point) => placed(pose, point)), triangles }] : [];
  });
}

/** The segments that the robot is drawn of, at these frames: { start, end, radius, frame }, in the base frame. */
export function segmentsAt(geometry, frames, thin) {
  const segments = [];
  // What has meshes is drawn by these.
  const meshed = new Set(geometry.surfaces.map((one) => one.frame));
  const covered = new Set(meshed);
  for (const { frame, start, end, radius } of geometry.capsules) {
    if (meshed.has(frame)) continue;
    const pose = frame === null ? BASE : frames[frame];
    covered.add(frame);
    if (pose) segments.push({ start: placed(pose, start), end: placed(pose, end), radius, frame });
  }
  geometry.frames.forEach(({ parent }, place) => {
    // A link without geometry is a rod from its joint's origin to those of the next.
    if (!frames[place] || covered.has(parent)) return;
    segments.push({ start: origin(parent === null ? BASE : frames[parent]), end: origin(frames[place]), radius: thin, frame: parent });
  });
  const cut = geometry.loops.flatMap((one) => one.ends).filter(({ frame }) => frame !== null && frames[frame] && !covered.has(frame));
  for (const { frame, placement } of cut) segments.push({ start: origin(frames[frame]), end: origin(times(frames[frame], flat(placement))), radius: thin, frame });
  const carried = new Set([...geometry.frames.map((one) => one.parent), ...cut.map((one) => one.frame)]);
  geometry.frames.forEach((one, place) => {
    // The last link, whose end nothing says, is as long as the one before it: only that it turns is to be seen.
    if (!frames[place] || covered.has(place) || carried.has(place)) return;
    segments.push({ start: origin(frames[place]), end: placed(frames[place], tip(geometry, place)), radius: thin, frame: place });
  });
  return segments;
}

export function origin(pose) {
  return [pose[3], pose[7], pose[11]];
}

function tip(geometry, place) {
  let one = geometry.frames[place];
  let way = [one.placement[0][3], one.placement[1][3], one.placement[2][3]];
  while (Math.hypot(...way) < 1e-6 && one.parent !== null) {
    one = geometry.frames[one.parent];
    way = [one.placement[0][3], one.placement[1][3], one.placement[2][3]];
  }
  return Math.hypot(...way) < 1e-6 ? [0.3, 0, 0] : way;
}

function motion({ type, axis: [x, y, z] }, position) {
  if (type === "prismatic") return [1, 0, 0, x * position, 0, 1, 0, y * position, 0, 0, 1, z * position];
  const [c, s] = [Math.cos(position), Math.sin(position)];
  const v = 1 - c;
  return [
    c + x * x * v, x * y * v - z * s, x * z * v + y * s, 0,
    y * x * v + z * s, c + y * y * v, y * z * v - x * s, 0,
    z * x * v - y * s, z * y * v + x * s, c + z * z * v, 0,
  ];
}

export function flat(placement) {
  return placement.slice(0, 3).flat();
}

export function times(a, b) {
  const product = [];
  for (const row of [0, 4, 8]) {
    for (let column = 0; column < 4; column += 1) {
      const sum = a[row] * b[column] + a[row + 1] * b[4 + column] + a[row + 2] * b[8 + column];
      product.push(column === 3 ? sum + a[row + 3] : sum);
    }
  }
  return product;
}

// Points, surfaces and segments of a robot from its geometry and poses, as the API gives them.

/** A pose is 12 numbers, row by row: the rotation beside the origin. */
export const BASE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

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
  for (const { frame, placement } of cut) segments.push({ start: origin(frames[frame]), end: placed(frames[frame], beginning({ placement })), radius: thin, frame });
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

/** Where a frame begins in the one that it stands on. */
function beginning({ placement }) {
  return placement.slice(0, 3).map((row) => row[3]);
}

function tip(geometry, place) {
  const one = geometry.frames[place];
  const way = beginning(one);
  if (Math.hypot(...way) > 1e-6) return way;
  return one.parent === null ? [0.3, 0, 0] : tip(geometry, one.parent);
}

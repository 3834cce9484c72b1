// Segments with a radius, drawn in parallel projection on a canvas: there a capsule is a thick line with round ends.

import { origin, placed } from "./kinematics.js";

const AXES = [["--predicted", [1, 0, 0]], ["--good-line", [0, 1, 0]], ["--residual", [0, 0, 1]]];

/** A view has `turn` and `tilt` (rad), `middle` (m) and `reach` (m): what lies within it is on the canvas. */
export function draw(canvas, view, segments, frames, path) {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineCap = "round";
  const scale = (Math.min(width, height) / 2 / view.reach) * 0.92;
  const seen = projection(view, width, height, scale);
  ground(pen, seen, view, colour("--grid"));
  line(pen, path.map(seen), 1.5, colour("--residual"));
  const parts = segments.map((one) => ({ ...one, from: seen(one.start), to: seen(one.end) }));
  parts.sort((a, b) => a.from[2] + a.to[2] - b.from[2] - b.to[2]);
  for (const { from, to, radius } of parts) {
    const thick = Math.max(2 * radius * scale, 3);
    line(pen, [from, to], thick + 2, colour("--ink"));
    line(pen, [from, to], thick, colour("--rung-0"));
    line(pen, [from, to], thick / 3, colour("--line"));
  }
  const size = 0.09 * view.reach;
  for (const pose of frames.filter(Boolean)) {
    const from = seen(origin(pose));
    for (const [name, way] of AXES) line(pen, [from, seen(placed(pose, way.map((x) => x * size)))], 2.5, colour(name));
  }
}

/** Points of the base frame to [right, down, near] in pixels. */
function projection({ turn, tilt, middle }, width, height, scale) {
  const [ct, st, cu, su] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  return (point) => {
    const [x, y, z] = point.map((value, k) => value - middle[k]);
    const [right, away] = [ct * x + st * y, -st * x + ct * y];
    return [width / 2 + scale * right, height / 2 - scale * (cu * z + su * away), scale * (su * z - cu * away)];
  };
}

function line(pen, points, width, colour) {
  if (points.length < 2) return;
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.beginPath();
  pen.moveTo(points[0][0], points[0][1]);
  for (const [x, y] of points.slice(1)) pen.lineTo(x, y);
  pen.stroke();
}

/** The plane z = 0 of the base frame, in squares of a quarter of the reach. */
function ground(pen, seen, { reach }, colour) {
  for (let k = -4; k <= 4; k += 1) {
    const at = (k * reach) / 4;
    line(pen, [seen([at, -reach, 0]), seen([at, reach, 0])], 1, colour);
    line(pen, [seen([-reach, at, 0]), seen([reach, at, 0])], 1, colour);
  }
}

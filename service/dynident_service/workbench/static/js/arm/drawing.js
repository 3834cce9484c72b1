// Projection and painting of an arm on a canvas: triangles, and thick lines for capsules.

import { origin, placed } from "./kinematics.js";

const AXES = [["--predicted", [1, 0, 0]], ["--good-line", [0, 1, 0]], ["--residual", [0, 0, 1]]];

const LIGHT = [0.36, -0.48, 0.8]; // to the right, up and near: where the light comes from
const FLOOR_OPACITY = 0.25; // the floor is told from the background, and what is behind it stays visible
const DARKEST = 0.6; // of the colour, where no light comes

/**
 * A view has `turn` and `tilt` (rad), `middle` (m) and `reach` (m): what lies within it is on the canvas.
 * `surfaces` are [{ points, triangles }], `segments` [{ start, end, radius }], all in the base frame. `around` is what
 * stands there, { floor (m), outlines }, and `gaps` are [{ ends, text, nearest }]: lines to what parts are near to.
 */
export function draw(canvas, view, { surfaces, segments, frames, path, around, gaps }) {
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
  ground(pen, seen, view, around.floor, colour);
  for (const ends of around.outlines) line(pen, ends.map(seen), 1, colour("--soft"));
  line(pen, path.map(seen), 1.5, colour("--residual"));
  const parts = [...facesOf(surfaces, seen, shades(pen, colour("--rung-0"))), ...segments.map((one) => rod(one, seen, scale, colour))];
  parts.sort((a, b) => a.near - b.near);
  for (const part of parts) part.paint(pen);
  const size = 0.09 * view.reach;
  for (const pose of frames.filter(Boolean)) {
    const from = seen(origin(pose));
    for (const [name, way] of AXES) line(pen, [from, seen(placed(pose, way.map((x) => x * size)))], 2.5, colour(name));
  }
  for (const one of gaps) gap(pen, one, seen, width, colour);
}

/** A line between two points, the nearest of all with its length: on a ground of its own, whatever is behind it. */
function gap(pen, { ends, text, nearest }, seen, width, colour) {
  const [from, to] = ends.map(seen);
  line(pen, [from, to], nearest ? 5 : 3, colour("--paper"));
  line(pen, [from, to], nearest ? 2.5 : 1, colour(nearest ? "--warn-line" : "--soft"));
  if (!text) return;
  pen.font = "600 13px system-ui, sans-serif";
  const wide = pen.measureText(text).width;
  const left = Math.min(Math.max((from[0] + to[0]) / 2 + 8, 2), width - wide - 8);
  const base = Math.max((from[1] + to[1]) / 2 - 8, 16);
  pen.fillStyle = colour("--paper");
  pen.fillRect(left - 3, base - 13, wide + 6, 18);
  pen.fillStyle = colour("--ink");
  pen.fillText(text, left, base);
}

/** What paints the triangles, each with how near it is. */
function facesOf(surfaces, seen, shade) {
  return surfaces.flatMap(({ points, triangles }) => {
    const there = points.map(seen);
    return triangles.map((corners) => {
      const [a, b, c] = corners.map((one) => there[one]);
      return { near: (a[2] + b[2] + c[2]) / 3, paint: (pen) => triangle(pen, a, b, c, shade(a, b, c)) };
    });
  });
}

function rod({ start, end, radius }, seen, scale, colour) {
  const [from, to] = [seen(start), seen(end)];
  const thick = Math.max(2 * radius * scale, 3);
  const paint = (pen) => {
    line(pen, [from, to], thick + 2, colour("--ink"));
    line(pen, [from, to], thick, colour("--rung-0"));
    line(pen, [from, to], thick / 3, colour("--line"));
  };
  return { near: (from[2] + to[2]) / 2, paint };
}

function triangle(pen, a, b, c, colour) {
  pen.fillStyle = colour;
  pen.strokeStyle = colour; // a hair's breadth beyond, so that neighbours leave no gap
  pen.lineWidth = 0.7;
  pen.beginPath();
  pen.moveTo(a[0], a[1]);
  pen.lineTo(b[0], b[1]);
  pen.lineTo(c[0], c[1]);
  pen.closePath();
  pen.fill();
  pen.stroke();
}

/** The colour of a triangle as it lies to the light, either side alike: not every file winds its corners one way. */
function shades(pen, colour) {
  pen.fillStyle = colour; // reads back as #rrggbb, whatever the style sheet has
  const [red, green, blue] = [1, 3, 5].map((place) => parseInt(pen.fillStyle.slice(place, place + 2), 16));
  return (a, b, c) => {
    const [u, v] = [[b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]];
    const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const facing = Math.abs(normal.reduce((sum, value, k) => sum + value * LIGHT[k], 0)) / (Math.hypot(...normal) || 1);
    const lit = DARKEST + (1.3 - DARKEST) * facing;
    return `rgb(${[red, green, blue].map((one) => Math.min(255, Math.round(lit * one))).join(" ")})`;
  };
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

/** The floor at a height (m): a filled plane in squares of a quarter of the reach. Without a floor, the base plane in pale lines. */
function ground(pen, seen, { reach }, floor, colour) {
  const height = floor ?? 0;
  if (floor !== null) {
    pen.globalAlpha = FLOOR_OPACITY;
    pen.fillStyle = colour("--soft");
    pen.beginPath();
    for (const [x, y] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) pen.lineTo(...seen([x * reach, y * reach, height]).slice(0, 2));
    pen.fill();
    pen.globalAlpha = 1;
  }
  const shade = colour(floor === null ? "--grid" : "--line");
  for (let k = -4; k <= 4; k += 1) {
    const at = (k * reach) / 4;
    line(pen, [seen([at, -reach, height]), seen([at, reach, height])], 1, shade);
    line(pen, [seen([-reach, at, height]), seen([reach, at, height])], 1, shade);
  }
}

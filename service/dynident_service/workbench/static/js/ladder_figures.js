// Figures of ladders (errors step by step) and of the drift of a simulation; shared axes and grid.

import { h, svg } from "./dom.js";
import { judged } from "./joint_errors.js";
import { number, percent } from "./format.js";

/** Relative error of all joints, where they move, at each step, of the fit and held out. */
export function totalsFigure(rungs, heldOut) {
  const lines = [{ name: "fit", css: "fit", marker: "circle", values: rungs.map((one) => judged(one.residual).relative_total) }];
  if (heldOut) lines.push({ name: "held out", css: "held-out", marker: "square", values: rungs.map((one) => judged(one.validation).relative_total) });
  // The higher of the two marks has its figure above it, the lower one below: they never meet, however many steps.
  const isAbove = (line, k) => lines.every((one) => one === line || one.values[k] < line.values[k] || (one.values[k] === line.values[k] && line === lines[0]));
  return laddersFigure("Relative error where joints move (%)", 440, lines, (line, k) => ({ dx: 0, dy: isAbove(line, k) ? -11 : 19, anchor: "middle" }));
}

/** Ladders as { name, css, marker, values }; `place(line, k)` is where the figure of a mark stands beside it, null where nowhere. */
export function laddersFigure(title, width, lines, place) {
  const height = 260;
  const room = { left: 48, right: 16, top: 40, bottom: 34 };
  const count = Math.max(...lines.map((line) => line.values.length));
  const most = 1.15 * Math.max(...lines.flatMap((line) => line.values));
  const x = (k) => room.left + ((k + 0.5) / count) * (width - room.left - room.right);
  const y = (value) => height - room.bottom - (value / most) * (height - room.top - room.bottom);
  const figureOf = (line, value, k) => {
    const { dx, dy, anchor } = place(line, k) ?? {};
    return anchor && svg("text", { class: "figure", x: x(k) + dx, y: y(value) + dy, "text-anchor": anchor }, number(100 * value));
  };
  const drawn = lines.map((line) => [
    svg("polyline", { class: `line ${line.css}`, points: line.values.map((value, k) => `${x(k)},${y(value)}`).join(" ") }),
    line.values.map((value, k) => [marker(line.marker, x(k), y(value), line.css), figureOf(line, value, k)]),
  ]);
  const words = lines.map((line) => `${line.name}: ${line.values.map((value) => percent(value)).join(", ")}`).join("; ");
  // Of many only the number has room.
  const names = Array.from({ length: count }, (_, k) => svg("text", { x: x(k), y: height - 8, "text-anchor": "middle" }, count > 6 ? `${k + 1}` : `model ${k + 1}`));
  return h("figure", { class: "drawn" },
    h("figcaption", { class: "chart-title" }, title),
    svg("svg", { viewBox: `0 0 ${width} ${height}`, style: { "max-width": `${width}px` }, role: "img", "aria-label": `${title}. ${words}` },
      grid(ticksUpTo(100 * most), (value) => y(value / 100), room.left, width - room.right),
      names,
      drawn,
      lines.map((line, k) => [marker(line.marker, room.left + 12 + 120 * k, 14, line.css), svg("text", { x: room.left + 24 + 120 * k, y: 18 }, line.name)])),
  );
}

const JOINT_COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8d8d8d"];

/** How far a simulation without a controller is off after each time, by joint; a line ends where it diverged. */
export function driftFigure({ joint_names: joints, after, distance }) {
  const [plot, height] = [410, 260];
  // A name of the key needs about 7 px a letter.
  const room = { left: 56, right: 40 + 7 * Math.max(...joints.map((joint) => joint.length)), top: 14, bottom: 34 };
  const width = plot + room.right;
  const values = distance.flat().filter((value) => value > 0).map((value) => 1e3 * value);
  if (!values.length) return null;
  const [low, high] = [Math.log10(Math.min(...values)), Math.log10(Math.max(...values))];
  // Two and a half times from end to end at least, so that one of the ticks 1, 2, 5, 10, … lies inside.
  const margin = Math.max(0.06 * (high - low) + 0.05, (0.4 - (high - low)) / 2);
  const x = (k) => room.left + ((k + 0.5) / after.length) * (width - room.left - room.right);
  const y = (value) => height - room.bottom - ((Math.log10(value) - low + margin) / (high - low + 2 * margin)) * (height - room.top - room.bottom);
  const ticks = Array.from({ length: 24 }, (_, k) => 10 ** (Math.floor(low - margin) + Math.floor(k / 3)) * [1, 2, 5][k % 3]).filter((value) => y(value) <= height - room.bottom && y(value) >= room.top);
  const lines = joints.map((joint, j) => {
    const points = after.map((_, k) => [k, distance[k][j]]).filter(([, value]) => value > 0).map(([k, value]) => [x(k), y(1e3 * value)]);
    const stroke = JOINT_COLOURS[j % JOINT_COLOURS.length];
    const at = room.top + 8 + 18 * j;
    return svg("g", { "data-joint": joint },
      svg("polyline", { class: "line", style: { stroke }, points: points.map((point) => point.join(",")).join(" ") }),
      points.map(([cx, cy]) => svg("circle", { class: "mark-of", style: { fill: stroke }, cx, cy, r: 4 })),
      svg("line", { class: "line", style: { stroke }, x1: width - room.right + 10, x2: width - room.right + 28, y1: at, y2: at }),
      svg("text", { x: width - room.right + 34, y: at + 4 }, joint),
    );
  });
  const title = "Drift under the measured torque, without a controller: rms of the position (mrad or mm)";
  return h("figure", { class: "drawn", id: "drift-figure" },
    h("figcaption", { class: "chart-title" }, title),
    svg("svg", { viewBox: `0 0 ${width} ${Math.max(height, room.top + 18 * joints.length + 8)}`, style: { "max-width": `${width}px` }, role: "img", "aria-label": `${title}. The table has its values.` },
      grid(ticks, y, room.left, width - room.right),
      after.map((time, k) => svg("text", { x: x(k), y: height - 8, "text-anchor": "middle" }, `after ${time} s`)),
      lines),
  );
}

/** Lines across a figure, with their values. */
export function grid(values, y, left, right) {
  return values.map((value) => [
    svg("line", { class: "grid", x1: left, x2: right, y1: y(value), y2: y(value) }),
    svg("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, number(value, 2)),
  ]);
}

/** The mark of one model. */
function marker(kind, x, y, css) {
  return kind === "circle"
    ? svg("circle", { class: `mark-of ${css}`, cx: x, cy: y, r: 5 })
    : svg("rect", { class: `mark-of ${css}`, x: x - 4.5, y: y - 4.5, width: 9, height: 9 });
}

/** Round values from zero up. */
export function ticksUpTo(most) {
  return roundValues(0, most, most / 4);
}

/** Round values from one to another, at least so far apart. */
export function roundValues(low, high, apart) {
  const size = 10 ** Math.floor(Math.log10(apart));
  const step = size * [1, 2, 5, 10].find((one) => one * size >= apart);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, k) => (first + k) * step);
}

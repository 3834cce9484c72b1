// The ladder as a figure: the errors of all joints together, rung by rung.

import { h, svg } from "./dom.js";
import { number, percent } from "./format.js";

/** Relative error of all joints at each rung, of the fit and held out. */
export function totalsFigure(rungs, heldOut) {
  const [width, height] = [440, 260];
  const room = { left: 48, right: 16, top: 40, bottom: 34 };
  const lines = [{ name: "fit", css: "fit", marker: "circle", values: rungs.map((one) => one.residual.relative_total) }];
  if (heldOut) lines.push({ name: "held out", css: "held-out", marker: "square", values: rungs.map((one) => one.validation.relative_total) });
  const most = 1.15 * Math.max(...lines.flatMap((line) => line.values));
  const x = (k) => room.left + ((k + 0.5) / rungs.length) * (width - room.left - room.right);
  const y = (value) => height - room.bottom - (value / most) * (height - room.top - room.bottom);
  // The higher of the two marks has its figure above it, the lower one below: they never meet, however many rungs.
  const rise = (line, k) => (lines.every((one) => one === line || one.values[k] < line.values[k] || (one.values[k] === line.values[k] && line === lines[0])) ? -11 : 19);
  const drawn = lines.map((line) => { const { css, marker: kind, values } = line; return [
    svg("polyline", { class: `line ${css}`, points: values.map((value, k) => `${x(k)},${y(value)}`).join(" ") }),
    values.map((value, k) => [
      marker(kind, x(k), y(value), css),
      svg("text", { class: "figure", x: x(k), y: y(value) + rise(line, k), "text-anchor": "middle" }, number(100 * value)),
    ]),
  ]; });
  const words = lines.map((line) => `${line.name}: ${line.values.map((value) => percent(value)).join(", ")}`).join("; ");
  return figure(
    "Relative error, all joints (%)",
    svg("svg", { viewBox: `0 0 ${width} ${height}`, style: { "max-width": `${width}px` }, role: "img", "aria-label": `Relative error of each model. ${words}` },
      grid(ticksUpTo(100 * most), (value) => y(value / 100), room.left, width - room.right),
      rungs.map((_, k) => svg("text", { x: x(k), y: height - 8, "text-anchor": "middle" }, nameOf(k, rungs.length))),
      drawn,
      lines.map((line, k) => [marker(line.marker, room.left + 12 + 90 * k, 14, line.css), svg("text", { x: room.left + 24 + 90 * k, y: 18 }, line.name)])),
  );
}

/** What a rung is called: of many only its number has room. */
function nameOf(k, count) {
  return count > 6 ? `${k + 1}` : `model ${k + 1}`;
}

function figure(title, drawing) {
  return h("figure", { class: "drawn" }, h("figcaption", { class: "chart-title" }, title), drawing);
}

/** Lines across a figure, with their values. */
export function grid(values, y, left, right) {
  return values.map((value) => [
    svg("line", { class: "grid", x1: left, x2: right, y1: y(value), y2: y(value) }),
    svg("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, number(value, 2)),
  ]);
}

/** The mark of one model. */
export function marker(kind, x, y, css) {
  return kind === "circle"
    ? svg("circle", { class: `mark-of ${css}`, cx: x, cy: y, r: 5 })
    : svg("rect", { class: `mark-of ${css}`, x: x - 4.5, y: y - 4.5, width: 9, height: 9 });
}

/** Round values from zero up. */
export function ticksUpTo(most) {
  const raw = most / 4;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * [1, 2, 5, 10].find((one) => one * size >= raw);
  return Array.from({ length: Math.floor(most / step) + 1 }, (_, k) => k * step);
}

// Figure of one parameter day by day with its intervals, and the choice of the parameter.

import { lastAsked } from "./api.js";
import { h, select } from "./dom.js";
import { quantity } from "./format.js";
import { colour, figure, onColours } from "./plots.js";

/** A figure of one course, and a choice among all of them: what has changed first. */
export function courseFigure(result, signal) {
  const changed = result.changes.flatMap((one) => [one.parameter, ...one.more.map((value) => value.parameter)]);
  const known = result.courses.filter((one) => one.values.some((value) => value !== null));
  if (!known.length) return null;
  const rank = (one) => (changed.includes(one.parameter) ? changed.indexOf(one.parameter) : changed.length + (one.varies ? 0 : 1));
  const courses = known.map((one, index) => [one, index]).sort((a, b) => rank(a[0]) - rank(b[0]) || a[1] - b[1]).map(([one]) => one);
  const target = h("div", { class: "chart" });
  const drawing = lastAsked(signal);
  const draw = (index) => paint(target, result.days, courses[index], drawing());
  const state = { index: 0 };
  const names = courses.map((one, index) => [String(index), `${one.parameter} (${one.unit})${one.joint ? `, ${one.joint}` : ""}${changed.includes(one.parameter) ? ", changed" : ""}`]);
  const control = select(names, "0", (value) => { state.index = Number(value); draw(state.index); }, { id: "course" });
  onColours(() => { if (target.isConnected) draw(state.index); }, signal);
  requestAnimationFrame(() => draw(0));
  return h("div", { id: "courses" }, h("p", {}, h("label", { for: "course" }, "Course of "), control), target);
}

function paint(target, days, course, signal) {
  const numbers = days.map((_, index) => index + 1);
  const upright = (_, ticks, __, ___, step) => ticks.map((one) => one.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))));
  figure(target, {
    title: `${course.parameter} day by day, with 95 % intervals`,
    height: 230,
    x: { label: "day", words: (raw) => days[raw - 1], values: numbers, scale: { range: () => [0.5, days.length + 0.5] }, axis: { splits: () => numbers, values: (_, ticks) => ticks.map((one) => shortened(days[one - 1], days.length)) } },
    y: { label: `${course.parameter} (${course.unit})`, words: (raw) => quantity(raw, course.unit), axis: { values: upright } },
    band: { names: ["upper end", "lower end"], ends: [course.upper, course.lower] },
    lines: [{ label: course.parameter, values: course.values, stroke: colour("predicted"), width: 1, points: { show: true, size: 7, fill: colour("predicted") } }],
    options: { bands: [], hooks: { draw: [(made) => bars(made, course)] } },
  }, signal);
  if (!course.varies) target.append(h("p", { class: "note" }, "It is assumed to be constant: the data of all days are used for each day."));
}

/** The interval of each day as an upright bar. */
function bars(figure, { upper, lower }) {
  const { ctx } = figure;
  ctx.save();
  ctx.strokeStyle = colour("predicted");
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.beginPath();
  upper.forEach((high, index) => {
    if (high === null || lower[index] === null) return;
    const x = figure.valToPos(index + 1, "x", true);
    ctx.moveTo(x, figure.valToPos(lower[index], "y", true));
    ctx.lineTo(x, figure.valToPos(high, "y", true));
  });
  ctx.stroke();
  ctx.restore();
}

/** A day's name as it fits below the axis. */
function shortened(name, count) {
  const room = Math.max(4, Math.floor(110 / count));
  return name.length > room ? `${name.slice(0, room - 1)}…` : name;
}

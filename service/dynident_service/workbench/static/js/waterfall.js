// Figure of each joint's error from the first model to the last, with the noise floor.

import { h, svg } from "./dom.js";
import { percent } from "./format.js";
import { grid, ticksUpTo } from "./ladder_figures.js";

const [WIDTH, HEIGHT] = [260, 170];
const ROOM = { left: 40, right: 8, top: 16, bottom: 24 };
// A step smaller than this is drawn as a line that can be seen.
const THINNEST = 1.5;
// Times the error before: less of a rise is none, and what the program warns of is more.
const RISES = 1.02;

/** `errors` of each step with { relative, rms }, `floors` in the unit of rms (null where nobody knows). */
export function waterfallFigure(errors, joints, floors, kind) {
  const panels = joints.map((joint, index) => {
    const values = errors.map((one) => one.relative[index]).filter((value) => value !== null);
    return values.length < 2 ? null : panel(joint, values, relativeFloor(errors, index, floors[index]));
  });
  const key = [["first", "first model"], ["falls", "falls"], ["rises", "rises"], ["last", "last model"], ["floor", "noise floor"]];
  return h("figure", { class: "drawn waterfall", id: "waterfall" },
    h("figcaption", { class: "chart-title" }, `How each step changes every joint's relative error, ${kind} (%)`),
    h("p", { class: "key" }, key.map(([css, words]) => h("span", {}, h("span", { class: `swatch ${css}` }), words))),
    h("div", { class: "panels" }, panels),
  );
}

/** The noise as a share of the torque: as the error's share is to its size. */
function relativeFloor(errors, index, floor) {
  const { relative, rms } = errors.at(-1);
  return floor && rms?.[index] ? (floor / rms[index]) * relative[index] : null;
}

function panel(joint, values, floor) {
  const most = 1.08 * Math.max(...values, floor ?? 0);
  const bars = values.length + 1;
  const pitch = (WIDTH - ROOM.left - ROOM.right) / bars;
  const y = (value) => HEIGHT - ROOM.bottom - (value / most) * (HEIGHT - ROOM.top - ROOM.bottom);
  const bar = (k, from, to, css, words) => {
    const high = Math.max(THINNEST, Math.abs(y(from) - y(to)));
    return svg("rect", { class: css, x: ROOM.left + pitch * (k + 0.14), y: Math.min(y(from), y(to)), width: 0.72 * pitch, height: high }, svg("title", {}, words));
  };
  const steps = values.slice(1).map((value, k) => {
    const rises = value > RISES * values[k];
    return [
      bar(k + 1, values[k], value, rises ? "rises" : value > values[k] ? "stays" : "falls", `model ${k + 2}: ${percent(values[k])} → ${percent(value)}`),
      // Told by more than its colour.
      rises ? svg("text", { class: "rises", x: ROOM.left + pitch * (k + 1.5), y: y(value) - 4, "text-anchor": "middle" }, "▲") : null,
    ];
  });
  const words = `${joint}: ${values.map((value) => percent(value)).join(", then ")}${floor === null ? "" : `; the noise floor is ${percent(floor)}`}`;
  const named = (k, text) => svg("text", { x: ROOM.left + pitch * (k + 0.5), y: HEIGHT - 8, "text-anchor": "middle" }, text);
  return h("div", { class: "panel", "data-joint": joint },
    h("p", { class: "panel-title" }, joint, h("small", {}, ` ${percent(values[0])} → ${percent(values.at(-1))}`)),
    svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": words },
      grid(ticksUpTo(100 * most), (value) => y(value / 100), ROOM.left, WIDTH - ROOM.right),
      bar(0, 0, values[0], "first", `model 1: ${percent(values[0])}`),
      steps,
      bar(values.length, 0, values.at(-1), "last", `model ${values.length}: ${percent(values.at(-1))}`),
      floor === null ? null : svg("line", { class: "floor", x1: ROOM.left, x2: WIDTH - ROOM.right, y1: y(floor), y2: y(floor) }),
      values.map((_, k) => named(k, String(k + 1))),
      named(values.length, "now")),
  );
}

// Figures of a designed motion: each joint within its limits, with a common cursor.

import { h, put, select } from "../dom.js";
import { axis, colour, onColours, plot } from "../plots.js";

const HEIGHT = 150;
const QUANTITIES = [
  ["q", "position", "", ["position_min", "position_max"]],
  ["dq", "velocity", "/s", ["velocity"]],
  ["ddq", "acceleration", "/s²", ["acceleration"]],
];

/** Curves of a motion { t, q, dq, ddq } with the bounds of a design's margins; `onTime(time)` is told of the cursor. */
export function motionCurves(motion, result, units, onTime, signal) {
  const charts = h("div", { id: "motion-curves" });
  let quantity = QUANTITIES[0];
  let drawn = [];

  function show() {
    for (const { made } of drawn) made.destroy();
    put(charts, result.joints.map((joint) => h("div", {}, h("p", { class: "panel-title" }, joint), h("div", { class: "chart" }))));
    drawn = result.joints.map((joint, place) => {
      const made = plot(charts.children[place].lastChild, options(joint, place), data(joint, place), signal);
      const marker = h("div", { class: "time-marker" });
      made.over.append(marker);
      return { made, marker };
    });
  }

  function bounds(joint) {
    const of = (name) => result.margins.find((one) => one.joint === joint && one.limit === name)?.bound ?? null;
    const found = quantity[3].map(of);
    return found.length === 2 ? found : [found[0] === null ? null : -found[0], found[0]];
  }

  function data(joint, place) {
    const curve = motion[quantity[0]].map((row) => row[place]);
    return [motion.t, curve, ...bounds(joint).map((bound) => motion.t.map(() => bound))];
  }

  function options(joint, place) {
    const limit = { stroke: colour("predicted"), width: 1.5, dash: [6, 4], points: { show: false } };
    return {
      height: HEIGHT,
      legend: { show: false },
      cursor: { sync: { key: "motion" }, drag: { x: false, y: false } },
      scales: { x: { time: false } },
      axes: [axis("time (s)", 2), { ...axis(`${units[place]}${quantity[2]}`, 3), space: 20 }],
      series: [{}, { label: joint, stroke: colour("residual"), width: 1.5, points: { show: false } }, { label: "lower limit", ...limit }, { label: "upper limit", ...limit }],
      hooks: { setCursor: [(made) => { if (made.cursor.event && made.cursor.idx !== null) onTime(motion.t[made.cursor.idx]); }] },
    };
  }

  /** Put the line of time somewhere. */
  function mark(time) {
    for (const { made, marker } of drawn) marker.style.left = `${made.valToPos(time, "x")}px`;
  }

  const choose = select(QUANTITIES.map(([id, name]) => [id, name]), "q", (id) => {
    quantity = QUANTITIES.find(([known]) => known === id);
    show();
  }, { "aria-label": "What the curves show" });
  onColours(show, signal);
  const element = h("div", {}, h("p", { class: "actions" }, h("label", {}, "Curves of the ", choose), h("span", { class: "note" }, "Dashed: the limits. Move over a curve to see the arm there.")), charts);
  return { element, show, mark };
}

// Result of a design: criterion, motion, margins, expected uncertainties, downloads.

import { get } from "../api.js";
import { h, part, put } from "../dom.js";
import { positionUnit, quantity } from "../format.js";
import { inPageWords } from "../recordings/remedies.js";
import { formatLinks } from "../save_file.js";
import { choicesOfQuery } from "../schema.js";
import { byName, foldedTable, shownTable } from "../tables.js";
import { motionCurves } from "./joint_curves.js";
import { virtualRobot } from "./virtual_measurement.js";

const MOST_POINTS = 1500;

/** Put a design that succeeded into `target`. */
export async function designResult(target, design, robot, signal) {
  const formats = await choicesOfQuery("/v1/designs/{design_id}/trajectory", "format");
  const motion = part("The motion", h("p", { class: "note" }, "Loading …"));
  const { quality, runs, expected, limits } = byName(design);
  put(target, worth(design.result, quality), take(design, formats), virtualRobot(design, robot, signal), motion, runs ? shownTable(runs) : null,
    expected ? part("Expected accuracy", shownTable(expected, { id: "promises" })) : null, h("div", { id: "margins" }, foldedTable(limits)));
  await showMotion(motion, design, robot, signal);
}

function worth({ notes, warnings = [], remedies }, quality) {
  const words = (sentence) => inPageWords(sentence, remedies);
  const others = notes.filter((one) => !warnings.includes(one)).map(words);
  return part("What the motion shows",
    h("div", { class: "folded" }, shownTable(quality, { id: "design-quality" })), warnings.map((one) => h("p", { class: "box warning", role: "alert" }, words(one))),
    others.length ? h("details", {}, h("summary", {}, `Notes (${others.length})`), h("ul", {}, others.map((one) => h("li", {}, one)))) : null);
}

function take(design, formats) {
  const said = h("div");
  const links = (speed) => h("p", { class: "actions" }, formatLinks(formats, (format) => `/v1/designs/${design.id}/trajectory?format=${format}&speed=${speed}`, said));
  return part("For the controller", links(1), h("details", { class: "slow" }, h("summary", {}, "For a first run, at a third of the speed"), links(1 / 3)), h("p", { class: "note" }, "Run it, record positions and torques or currents, then add the recording under New model."), said);
}

async function showMotion(section, design, robot, signal) {
  const [arm, whole] = await Promise.all([import("../arm/arm.js"), get(`/designs/${design.id}/trajectory`, { format: "json" }, signal)]);
  const step = Math.ceil(whole.t.length / MOST_POINTS);
  const motion = Object.fromEntries(["t", "q", "dq", "ddq"].map((name) => [name, whole[name].filter((_, index) => index % step === 0)]));
  const units = robot.joints.map((one) => positionUnit(one.type === "revolute" ? "N m" : "N"));
  const place = h("div");
  let moved = () => {};
  const curves = motionCurves(motion, design.result, units, (time) => moved(time), signal);
  const floor = floorOf(design);
  put(section, h("h2", {}, "The motion"), h("p", { class: "note", id: "floor" }, floor.words), h("div", { class: "two" }, place, curves.element));
  curves.show();
  const mounted = await arm.mountArm(place, { robotId: robot.id, times: motion.t, positions: motion.q, floor: floor.height, onTime: curves.mark, signal });
  moved = (time) => {
    mounted.show(time);
    curves.mark(time);
  };
  curves.mark(motion.t[0]);
  const [{ clearancesOf }, found] = await Promise.all([import("../arm/clearances.js"), get(`/designs/${design.id}/clearances`, {}, signal)]);
  mounted.surround(found);
  if (found.links.length) mounted.keepClear(clearancesOf(found));
}

/** The height (m) of the floor that the motion was checked against, null for none, and what the picture shows of it. */
function floorOf({ request, result }) {
  const stated = request.surroundings?.floor ?? null;
  const height = result.floor ?? stated;
  if (height === null) return { height, words: "No floor was checked: the pale lines only show the base plane (z = 0)." };
  if (stated === null) return { height, words: "The grey plane is an assumed floor through the base (z = 0), because no surroundings were stated. Only the first link may reach it." };
  return { height, words: `The grey plane is the stated floor at z = ${quantity(height, "m")}.` };
}

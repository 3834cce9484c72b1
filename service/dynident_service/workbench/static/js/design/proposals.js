// Next experiments that diagnoses of a robot propose.

import { get } from "../api.js";
import { h } from "../dom.js";
import { moment } from "../format.js";
import { address } from "../page_address.js";

const LATEST = 50;

/** The next experiment of one diagnosis; null if it has none. */
export async function proposalOf(diagnosisId, signal) {
  const { result } = await get(`/diagnoses/${diagnosisId}`, {}, signal);
  return result?.next_experiment ?? null;
}

/** What is to be done next, and why. */
export function nextBox(title, next, ...more) {
  return h("div", { class: "box" }, h("p", {}, h("strong", {}, `${title}. `), next.reason),
    next.instructions?.length ? h("ol", {}, next.instructions.map((step) => h("li", {}, step))) : null, more);
}

/** Links to the newest experiments that were proposed for diagnoses of a robot's models. */
export async function proposals(robot, signal) {
  const { items } = await get("/next_experiments", { limit: LATEST }, signal);
  const mine = items.filter((one) => one.result?.experiment?.design.robot_id === robot.id);
  if (!mine.length) return null;
  return h("section", { "aria-label": "Proposed" }, h("h2", {}, "Proposed by diagnoses"), h("ul", {}, mine.slice(0, 5).map((one) =>
    h("li", {}, h("a", { href: address({ view: "design", robot: robot.id, diagnosis: one.request.diagnosis_id }) }, "Fill it in"), ` ${one.result.experiment.reason} `, h("span", { class: "note" }, moment(one.created_at))))));
}

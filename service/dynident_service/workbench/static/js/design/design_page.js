// Page that designs an experiment: form, progress, result.

import { get } from "../api.js";
import { announce, field, figures, h, listed, put, select } from "../dom.js";
import { moment, number } from "../format.js";
import { awaited } from "../jobs.js";
import { address, go } from "../page_address.js";
import { problemBox } from "../problem.js";
import { descent } from "./criterion_descent.js";
import { designForm } from "./design_form.js";
import { designResult } from "./design_result.js";
import { nextBox, proposalOf, proposals } from "./proposals.js";

/** With `design` that one, else a form for a new one; with `diagnosis` filled in as it proposes. */
export async function page(target, wanted, signal) {
  document.title = "Design: dynident";
  if (wanted.design) return onePage(target, wanted.design, signal);
  const [{ items: robots }, next] = await Promise.all([get("/robots", { limit: 200 }, signal), wanted.diagnosis ? proposalOf(wanted.diagnosis, signal) : null]);
  const robot = robots.find((one) => one.id === (next?.design.robot_id ?? wanted.robot)) ?? robots[0];
  if (!robot) {
    put(target, h("h1", {}, "Design an experiment"), h("div", { class: "box warning" }, "There is no robot yet. ", h("a", { href: address({ view: "new" }) }, "Make one from its description"), " first."));
    return;
  }
  const choose = select(robots.map((one) => [one.id, one.name]), robot.id, (id) => go({ view: "design", robot: id }), { id: "design-robot" });
  const [form, proposed, earlier] = await Promise.all([designForm(robot, next?.design ?? {}), next ? null : proposals(robot, signal), earlierDesigns(robot, signal)]);
  put(
    target,
    h("h1", {}, "Design an experiment"),
    h("p", {}, "A motion within the robot's limits that determines its parameters as accurately as possible."),
    h("div", { class: "bar-of-fields" }, field("Robot", choose)),
    next ? nextBox("Next experiment, filled in below", next) : proposed,
    form,
    earlier,
  );
}

async function earlierDesigns(robot, signal) {
  const { items } = await get("/designs", { robot_id: robot.id, limit: 50 }, signal);
  if (!items.length) return null;
  const columns = [
    ["design", (one) => h("a", { href: address({ view: "design", robot: robot.id, design: one.id }) }, one.name ?? `${one.request.kind.replaceAll("_", " ")}, ${one.request.criterion.name.replaceAll("_", " ")}`)],
    ["date", (one) => moment(one.created_at)],
    ["state", (one) => h("span", { class: `mark ${one.status}` }, one.status)],
    figures("criterion", (one) => one.result?.criterion_values.criterion ?? null, (value) => number(value)),
    figures("best random", (one) => one.result?.baseline_values?.criterion ?? null, (value) => number(value)),
  ];
  return h("section", { "aria-label": "Designs" }, h("h2", {}, "Existing designs"), listed("Designs of this robot", columns, items, { id: "designs-table" }));
}

async function onePage(target, id, signal) {
  const first = await get(`/designs/${id}`, {}, signal);
  const robot = await get(`/robots/${first.request.robot_id}`, {}, signal);
  const title = first.name ?? "Design";
  document.title = `${title}: dynident`;
  const body = h("div");
  const course = descent(first.job_id, signal);
  put(target, h("p", {}, h("a", { href: address({ view: "design", robot: robot.id }) }, "← All designs of this robot")), h("h1", {}, title),
    h("p", { class: "note" }, `${robot.name}; ${moment(first.created_at)}`), body, course.element, again(robot, first));
  try {
    const design = await awaited("/designs", first, "Designing", body, signal);
    if (first.status !== "succeeded") announce("The design is ready");
    course.end(design.result);
    await designResult(body, design, robot, signal);
  } catch (error) {
    if (signal.aborted) return;
    put(body, problemBox(error), h("p", {}, "Change the request below and design again."));
    target.querySelector("#design-again").open = true;
  }
}

/** The form with what was asked, so that a second try is not typed anew. */
function again(robot, design) {
  const place = h("div");
  const fill = async (event) => {
    if (event.target.open && !place.firstChild) put(place, await designForm(robot, design.request));
  };
  return h("details", { id: "design-again", ontoggle: fill }, h("summary", {}, "Change the request and design again"), place);
}

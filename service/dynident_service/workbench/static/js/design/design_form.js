// Form of a design request, by the contract's fields and choices.

import { get, post } from "../api.js";
import { controls, said as saidBy, sorted } from "../request_controls.js";
import { catalogue } from "../catalogue.js";
import { field, h, select } from "../dom.js";
import { moment } from "../format.js";
import { go } from "../page_address.js";
import { sending } from "../problem.js";
import { fieldsOf } from "../schema.js";
import { limitsTable } from "./limits_table.js";
import { obstacles } from "./obstacles.js";
import { purposeChoice } from "./purpose.js";

// What most people ask for stands in the open, in this order; the rest of what may be asked is folded.
const OPEN = ["family", "duration", "sampling_rate", "harmonics", "time_budget", "random_trajectories", "seed"];
const APART = ["robot_id", "earlier_ids", "identification_id", "kind", "criterion", "trajectory", "standing"];
const BUDGET = 15;

/** A form that designs an experiment for a robot; `given` is a body of a design to begin with. */
export async function designForm(robot, given) {
  const bodies = ["DesignRequest", "Trajectory", "Criterion", "Standing"];
  const [effects, asked, trajectory, criterion, standing] = await Promise.all([catalogue(), ...bodies.map(fieldsOf)]);
  const start = { time_budget: BUDGET, ...given };
  const name = h("input", { maxlength: 200, id: "design-name", value: given.name ?? "" });
  const purpose = purposeChoice(robot, effects, criterion.name["x-choices"], given.criterion);
  const limits = limitsTable(robot, given);
  const { items } = await get("/identifications", { robot_id: robot.id, limit: 100, brief: true });
  const models = items.filter((one) => one.status === "succeeded" || one.id === given.identification_id);
  const model = select([["", "the description"], ...models.map((one) => [one.id, `${one.name || robot.name}, ${moment(one.created_at)}`])], given.identification_id ?? "", null, { id: "design-identification" });
  const prefix = "design-";
  const around = await obstacles(given.surroundings, prefix);
  const [kind] = controls({ kind: asked.kind }, { given, prefix });
  const moves = controls(trajectory, { given: given.trajectory, pointer: "/trajectory", prefix });
  const stands = controls(standing, { given: given.standing, pointer: "/standing", prefix: `${prefix}standing-` });
  const own = controls(asked, { but: APART, given: start, prefix });
  const [open, folded] = sorted([...moves, ...own], OPEN);
  const said = h("div");
  const submit = h("button", { class: "main", id: "run-design" }, "Design the experiment");

  const send = sending(submit, said, async () => {
    const made = await post("/designs", {
      ...given,
      robot_id: robot.id,
      name: name.value.trim() || null,
      identification_id: model.value || null,
      kind: kind.read(),
      criterion: purpose.read(),
      ...limits.read(),
      ...around.read(),
      trajectory: { ...given.trajectory, ...saidBy(moves) },
      standing: { ...given.standing, ...saidBy(stands) },
      ...saidBy(own),
    });
    go({ view: "design", robot: robot.id, design: made.id });
  });
  return h("form", { id: "design-form", onsubmit: send, novalidate: true },
    purpose.element,
    h("div", { class: "fields" }, kind.element, open.map((one) => one.element)),
    limits.element,
    around.element,
    h("details", { class: "more", id: "design-standing", open: Boolean(given.standing?.feet?.length), "data-pointer": "/standing" },
      h("summary", {}, "A robot that stands on its feet"), h("div", { class: "fields" }, stands.map((one) => one.element))),
    h("div", { class: "fields" },
      field("Torque predicted by", model, { pointer: "/identification_id", hint: "An identified model knows friction and rotors, too." }),
      field("Name", name, { pointer: "/name" })),
    h("details", { class: "more", id: "design-more" }, h("summary", {}, "More options"), h("div", { class: "fields" }, folded.map((one) => one.element))),
    said,
    h("p", {}, submit),
  );
}

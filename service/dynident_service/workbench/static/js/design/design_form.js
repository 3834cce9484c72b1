// What is asked of an experiment; its choices and words are those of the contract.

import { post } from "../api.js";
import { catalogue } from "../catalogue.js";
import { field, h, put, select } from "../dom.js";
import { go } from "../location.js";
import { clearForm, showInForm } from "../problem.js";
import { fieldsOf } from "../schema.js";
import { limitsTable } from "./limits_table.js";
import { purposeChoice } from "./purpose.js";

const TRAJECTORY = [["family", "Motion"], ["duration", "Duration (s)"], ["sampling_rate", "Sampling rate (Hz)"], ["harmonics", "Harmonics"]];
const OWN = [["time_budget", "Time for the search (s)"], ["random_trajectories", "Random motions beside it"], ["seed", "Seed"]];
const BUDGET = 15;

/** A form that designs an experiment for a robot; `given` is a body of a design to begin with. */
export async function designForm(robot, given) {
  const [effects, asked, trajectory, criterion] = await Promise.all([catalogue(), fieldsOf("DesignRequest"), fieldsOf("Trajectory"), fieldsOf("Criterion")]);
  const start = { time_budget: BUDGET, ...given };
  const name = h("input", { maxlength: 200, id: "design-name", value: given.name ?? "" });
  const purpose = purposeChoice(robot, effects, criterion.name["x-choices"], given.criterion);
  const kind = choice("kind", "How the joints move", asked.kind, given.kind, "/kind");
  const limits = limitsTable(robot, given);
  const moves = TRAJECTORY.map(([id, label]) => control(id, label, trajectory[id], given.trajectory?.[id], `/trajectory/${id}`));
  const more = OWN.map(([id, label]) => control(id, label, asked[id], start[id], `/${id}`));
  const said = h("div");
  const submit = h("button", { class: "main", id: "run-design" }, "Design the experiment");

  const send = async (event) => {
    event.preventDefault();
    clearForm(form, said);
    submit.disabled = true;
    const body = {
      ...given,
      robot_id: robot.id,
      name: name.value.trim() || null,
      kind: kind.read(),
      criterion: purpose.read(),
      ...limits.read(),
      trajectory: { ...given.trajectory, ...Object.fromEntries(moves.map((one) => [one.id, one.read()])) },
      ...Object.fromEntries(more.map((one) => [one.id, one.read()])),
    };
    try {
      const made = await post("/designs", body);
      go({ view: "design", robot: robot.id, design: made.id });
    } catch (error) {
      showInForm(form, said, error);
    }
    submit.disabled = false;
  };
  const form = h(
    "form",
    { id: "design-form", onsubmit: send, novalidate: true },
    purpose.element,
    h("div", { class: "fields" }, kind.element, moves.map((one) => one.element)),
    limits.element,
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" }), more.map((one) => one.element)),
    said,
    h("p", {}, submit),
  );
  return form;
}

/** A choice with what the chosen one is for beneath it. */
function choice(id, label, schema, value, pointer) {
  const all = schema["x-choices"];
  const words = (name) => all.find((one) => one.name === name).words;
  const chosen = value ?? schema.default;
  const made = select(all.map((one) => [one.name, one.label]), chosen, (name) => { hint.textContent = words(name); }, { id: `design-${id}` });
  const element = field(label, made, { pointer, hint: words(chosen) });
  const hint = element.querySelector("small");
  return { id, element, read: () => made.value };
}

/** A control of a field as its schema has it: one of several, or a number. */
function control(id, label, schema, value, pointer) {
  if (schema["x-choices"]) return choice(id, label, schema, value, pointer);
  const made = h("input", { type: "number", step: "any", id: `design-${id}`, value: value ?? schema.default ?? "" });
  const read = () => (made.value === "" ? (schema.default ?? null) : Number(made.value));
  return { id, element: field(label, made, { pointer }), read };
}

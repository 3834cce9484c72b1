// Form of an identification: measurements, effects, method, and the button that runs it.

import { post } from "./api.js";
import { controls, said as saidBy } from "./request_controls.js";
import { catalogue } from "./catalogue.js";
import { field, h, put } from "./dom.js";
import { counted } from "./format.js";
import { go } from "./page_address.js";
import { NO_PRIOR } from "./methods.js";
import { complaint, sending } from "./problem.js";
import { fieldsOf, optionsOf } from "./schema.js";
import { usesOf } from "./measurement_uses.js";

const METHODS = ["model", "strategy", "steps", "estimator", "prior"];
const APART = [...METHODS, "robot_id", "name", "measurement_ids", "validation_ids", "effects"];
const USES = [["fit", "fit"], ["hold", "hold out"], ["", "leave out"]];

/** A form that identifies a robot and goes to the new model; `update(measurements)` keeps what has been filled in. */
export async function identificationForm(robot) {
  const [{ items }, asked, options, ofFilters] = await Promise.all([catalogue(), fieldsOf("IdentificationRequest"), optionsOf("IdentificationRequest", "estimator"), fieldsOf("Preprocessing")]);
  const usualEffects = asked.effects.examples[0].map((one) => one.effect); // Those for recordings of a real robot.
  const uses = usesOf(USES, { usual: (one) => (revised.has(one.id) ? "" : useOf(one)), called: "Use", about: (one) => counted(one.n_samples, "sample") });
  let revised = new Set();
  const name = h("input", { name: "name", id: "model-name", maxlength: 200, placeholder: robot.name });
  const ways = controls(Object.fromEntries(METHODS.map((id) => [id, asked[id]])), { none: NO_PRIOR, longestLabel: 0 });
  const { strategy, steps, estimator } = Object.fromEntries(ways.map((one) => [one.id, one]));
  const showSteps = () => { steps.element.hidden = strategy.read() !== "sequential"; };
  strategy.input.addEventListener("change", showSteps);
  showSteps();
  const more = controls(asked, { but: APART, prefix: "identify-" });
  const filters = controls(ofFilters, { pointer: "/preprocessing", prefix: "filter-" });
  for (const one of filters) one.input.placeholder = ofFilters[one.id].default;
  const ofEstimator = h("div", { class: "fields", id: "estimator-options" });
  let ownOptions = [];
  const fillOptions = () => {
    ownOptions = controls(options.get(estimator.read()) ?? {}, { pointer: "/estimator", prefix: "estimator-" });
    put(ofEstimator, ownOptions.map((one) => one.element));
  };
  estimator.input.addEventListener("change", fillOptions);
  fillOptions();
  const effects = items.map((one) => h("label", { title: one.signature, "data-effect": one.id }, h("input", { type: "checkbox", name: "effect", value: one.id, checked: usualEffects.includes(one.id) }), ` ${one.title}`));
  const said = h("div");
  const submit = h("button", { class: "main", id: "run" }, "Run the identification");

  const update = (measurements) => {
    // Of a recording and its revision only the revision is meant: both have the same samples.
    revised = new Set(measurements.map((one) => one.parent_id));
    uses.update(measurements);
  };
  const send = sending(submit, said, async (form) => {
    // What was confirmed a moment ago is waited for.
    await Promise.all([...document.querySelectorAll("form.card")].map((one) => one.storing));
    if (document.querySelector("form.card")) return void put(said, complaint("A file is not stored yet: confirm it, or leave it out."));
    const boxes = [...form.querySelectorAll("input[name=effect]:checked")];
    boxes.forEach((box, index) => { box.parentElement.dataset.pointer = `/effects/${index}`; });
    const made = await post("/identifications", {
      robot_id: robot.id,
      name: name.value || null,
      measurement_ids: uses.chosen("fit"),
      validation_ids: uses.chosen("hold"),
      effects: boxes.map((box) => ({ effect: box.value })),
      ...saidBy(ways),
      estimator: named(estimator.read(), saidBy(ownOptions)),
      ...saidBy(more),
      ...preprocessing(saidBy(filters)),
    });
    dispatchEvent(new Event("models-changed"));
    go({ identification: made.id });
  });
  const element = h("form", { onsubmit: send, id: "identify" },
    h("fieldset", { "data-pointer": "/measurement_ids" }, h("legend", {}, "Recordings"), uses.element),
    h("fieldset", { class: "checks-of", "data-pointer": "/effects" }, h("legend", {}, "Effects in the model"), effects),
    h("p", { class: "note" }, "Begin with the marked effects: the diagnosis names what is missing."),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" })),
    h("details", { class: "methods" }, h("summary", {}, "How to identify"), h("div", { class: "fields" }, ways.map((one) => one.element)), ofEstimator, h("div", { class: "fields" }, more.map((one) => one.element)), h("h3", {}, "Filters"), h("p", { class: "note" }, "What is left empty is chosen from the data."), h("div", { class: "fields", id: "filters" }, filters.map((one) => one.element))),
    said,
    h("p", {}, submit),
  );
  return { element, update };
}

/** A name, or with options that are not what they usually are an object. */
function named(name, options) {
  return Object.keys(options).length ? { name, ...options } : name;
}

/** Filters of which some are stated; nothing where none is. */
function preprocessing(filters) {
  return Object.keys(filters).length ? { preprocessing: filters } : {};
}

function useOf({ role }) {
  if (role === "validation") return "hold";
  return role === "payload" ? "" : "fit";
}

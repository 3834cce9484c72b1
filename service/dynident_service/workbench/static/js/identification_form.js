// Which measurements, which effects, which method; then Run.

import { post } from "./api.js";
import { controls, said as saidBy } from "./asked.js";
import { catalogue } from "./catalogue.js";
import { field, h, put, select } from "./dom.js";
import { counted } from "./format.js";
import { go } from "./location.js";
import { methods } from "./methods.js";
import { clearForm, pressed, showInForm } from "./problem.js";
import { fieldsOf, optionsOf } from "./schema.js";

const METHODS = ["model", "strategy", "steps", "estimator", "prior"];
const APART = [...METHODS, "robot_id", "name", "measurement_ids", "validation_ids", "effects"];
const USES = [["fit", "fit"], ["hold", "hold out"], ["", "leave out"]];

/** A form that identifies a robot and goes to the new model; `update(measurements)` keeps what has been filled in. */
export async function identificationForm(robot) {
  const [{ items }, { lists, chosen: usual }, asked, options] = await Promise.all([catalogue(), methods(), fieldsOf("IdentificationRequest"), optionsOf("IdentificationRequest", "estimator")]);
  const usualEffects = asked.effects.default.map((one) => one.effect);
  const uses = new Map(); // measurement's id -> its select
  const places = h("div", { class: "list-of-choices" });
  const name = h("input", { name: "name", id: "model-name", maxlength: 200, placeholder: robot.name });
  const [model, strategy, steps, estimator, prior] = METHODS.map((id) => explained(id, lists[id], usual[id]));
  strategy.control.addEventListener("change", () => { steps.element.hidden = strategy.control.value !== "sequential"; });
  steps.element.hidden = true;
  const more = controls(asked, { but: APART, prefix: "identify-" });
  const ofEstimator = h("div", { class: "fields", id: "estimator-options" });
  let ownOptions = [];
  const fillOptions = () => {
    ownOptions = controls(options.get(estimator.control.value) ?? {}, { pointer: "/estimator", prefix: "estimator-" });
    put(ofEstimator, ownOptions.map((one) => one.element));
  };
  estimator.control.addEventListener("change", fillOptions);
  fillOptions();
  const effects = items.map((one) => h("label", { title: one.signature, "data-effect": one.id }, h("input", { type: "checkbox", name: "effect", value: one.id, checked: usualEffects.includes(one.id) }), ` ${one.title}`));
  const said = h("div");
  const submit = h("button", { class: "main", id: "run" }, "Run the identification");

  const chosen = (use) => [...uses].filter(([, control]) => control.value === use).map(([id]) => id);
  const update = (measurements) => {
    // Of a recording and its revision only the revision is meant: both have the same samples.
    const revised = new Set(measurements.map((one) => one.parent_id));
    put(places, measurements.map((one) => {
      if (!uses.has(one.id)) uses.set(one.id, select(USES, revised.has(one.id) ? "" : useOf(one), null, { "aria-label": `Use of ${one.name}` }));
      return h("p", { class: "pick-one" }, uses.get(one.id), ` ${one.name} `, h("span", { class: "note" }, counted(one.n_samples, "sample")));
    }));
  };
  const send = async (event) => {
    event.preventDefault();
    clearForm(form, said);
    if (document.querySelector("form.card")) {
      put(said, h("p", { class: "complaint", role: "alert" }, "A file is not stored yet: confirm it, or leave it out."));
      return;
    }
    const boxes = [...form.querySelectorAll("input[name=effect]:checked")];
    boxes.forEach((box, index) => {
      box.parentElement.dataset.pointer = `/effects/${index}`;
    });
    const body = {
      robot_id: robot.id,
      name: name.value || null,
      measurement_ids: chosen("fit"),
      validation_ids: chosen("hold"),
      effects: boxes.map((box) => ({ effect: box.value })),
      estimator: named(estimator.control.value, saidBy(ownOptions)),
      model: model.control.value,
      strategy: strategy.control.value,
      steps: steps.control.value,
      prior: prior.control.value || null,
      ...saidBy(more),
    };
    await pressed(submit, async () => {
      const made = await post("/identifications", body);
      dispatchEvent(new Event("models-changed"));
      go({ identification: made.id });
    }, (error) => showInForm(form, said, error));
  };
  const form = h(
    "form",
    { onsubmit: send, id: "identify" },
    h("fieldset", { "data-pointer": "/measurement_ids" }, h("legend", {}, "Measurements"), places),
    h("fieldset", { class: "checks-of", "data-pointer": "/effects" }, h("legend", {}, "Effects in the model"), effects),
    h("p", { class: "note" }, "Begin with those that are marked: the diagnosis says what is missing."),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" })),
    h("details", { class: "methods" }, h("summary", {}, "How to identify"), h("div", { class: "fields" }, [model, strategy, steps, estimator, prior].map((one) => one.element)), ofEstimator, h("div", { class: "fields" }, more.map((one) => one.element))),
    said,
    h("p", {}, submit),
  );
  return { element: form, update };
}

/** A name, or with options that are not what they usually are an object. */
function named(name, options) {
  return Object.keys(options).length ? { name, ...options } : name;
}

/** A choice with what it is for beneath it; `id` is the field of the request. */
function explained(id, list, chosen) {
  const label = id[0].toUpperCase() + id.slice(1);
  const control = select(list.map(([value, text]) => [value, text]), chosen, (value) => { hint.textContent = aboutOf(list, value); }, { id, name: id });
  const element = field(label, control, { pointer: `/${id}`, hint: aboutOf(list, chosen) });
  const hint = element.querySelector("small");
  return { control, element };
}

function aboutOf(list, value) {
  return list.find(([known]) => known === value)[2];
}

function useOf({ role }) {
  if (role === "validation") return "hold";
  return role === "payload" ? "" : "fit";
}

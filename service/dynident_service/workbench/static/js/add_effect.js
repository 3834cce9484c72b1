// Dialog: add any effect of the catalogue by hand, on chosen joints.

import { aboutEffect } from "./catalogue.js";
import { field, h, put, select } from "./dom.js";
import { formula } from "./formula.js";
import { clearForm } from "./problem.js";

/** A form, folded away; `add(effects, said)` adds. */
export function addByHand(model, add) {
  const { items, byId } = model.effects;
  const places = h("fieldset", { class: "checks-of", "data-pointer": "/effects/0/joints" });
  const shapes = h("div", { class: "fields" });
  const about = h("div");
  const said = h("div");
  const choose = (id) => {
    const effect = byId.get(id);
    const boxes = model.joints.map((joint) => h("label", {}, h("input", { type: "checkbox", name: "joint", value: joint, checked: joint === model.joint }), ` ${joint}`));
    put(places, h("legend", {}, "Joints"), effect.scope === "robot" ? h("p", { class: "note" }, "It acts on the whole robot.") : boxes);
    put(shapes, effect.shape_parameters.map(constantField));
    put(about, aboutEffect(model.effects, id, formula));
  };
  const effect = select(items.map((one) => [one.id, one.title]), items[0].id, choose, { name: "effect", id: "effect-by-hand" });
  choose(items[0].id);
  const submit = (event) => {
    event.preventDefault();
    const joints = [...places.querySelectorAll("input:checked")].map((box) => box.value);
    const given = [...shapes.querySelectorAll("input, select")].filter((control) => control.value !== "");
    if (byId.get(effect.value).scope === "joint" && !joints.length) {
      put(said, h("p", { class: "complaint", role: "alert" }, "Choose at least one joint."));
      return;
    }
    const shape_parameters = Object.fromEntries(given.map((control) => [control.name, Number(control.value)]));
    clearForm(form, said);
    add([{ effect: effect.value, joints, shape_parameters }], said);
  };
  let form = null;
  return h("details", { id: "by-hand" },
    h("summary", {}, "Add an effect by hand"),
    (form = h("form", { onsubmit: submit }, field("Effect", effect), places, shapes, said, h("p", {}, h("button", {}, "Add to the model")), about)),
  );
}

/** A number to be given, or one of a few kinds by its word. */
function constantField(one) {
  const searched = "if empty, it is searched for where possible";
  const pointer = `/effects/0/shape/${one.name}`;
  if (!one.words?.length)
    return field(`${one.name} (${one.unit})`, h("input", { type: "number", step: "any", name: one.name }), { hint: `${one.description}, about ${one.default}; ${searched}`, pointer });
  const kinds = select([["", ""], ...one.words.map(({ value, word }) => [String(value), word])], "", null, { name: one.name });
  return field(one.name, kinds, { hint: searched, pointer });
}

// The catalogue of effects, read once; names of effects, joints and shape constants.

import { get, once } from "./api.js";
import { h } from "./dom.js";
import { quantity } from "./format.js";

/** A recommended effect in words: what the data show, as long as nobody has said that the robot has such a part. */
export function findingTitle(model, result, choice) {
  return (choice.question && result.candidates.find((one) => one.effect === choice.effect && one.question)?.title) || titleOf(model.effects, choice.effect);
}

/** The catalogue: { items, byId }. */
export const catalogue = once(async () => {
  const { items } = await get("/effects");
  return { items, byId: new Map(items.map((one) => [one.id, one])) };
});

/** The title of an effect. */
export function titleOf(effects, id) {
  return effects.byId.get(id)?.title ?? id;
}

/** Where an effect sits, in words. */
export function placeOf(effects, choice, all = []) {
  if (effects.byId.get(choice.effect)?.scope === "robot") return "the whole robot";
  if (!choice.joints.length || (all.length > 1 && choice.joints.length === all.length)) return "every joint";
  return choice.joints.join(", ");
}

/** An effect and its place, in words. */
export function choiceInWords(effects, choice, all = []) {
  return `${titleOf(effects, choice.effect)} on ${placeOf(effects, choice, all)}`;
}

/** What a value of a shape constant means that is a choice between kinds; null where it is a number. */
function kindInWords(effects, effect, name, value) {
  const words = effects.byId.get(effect)?.shape_parameters.find((one) => one.name === name)?.words ?? [];
  return words.find((one) => Math.abs(one.value - value) < 0.5)?.word ?? null;
}

/** Shape constants with their units. */
export function shapeInWords(effects, choice) {
  const known = effects.byId.get(choice.effect)?.shape_parameters ?? [];
  return Object.entries(choice.shape_parameters ?? {}).map(([name, value]) => {
    const kind = kindInWords(effects, choice.effect, name, value);
    if (kind) return `${name}: ${kind}`;
    const unit = known.find((one) => one.name === name)?.unit ?? "";
    return `${name} = ${quantity(value, unit)}`;
  }).join(", ");
}

/** The catalogue's entry, for people who want to know what an effect is. */
export function aboutEffect(effects, id, formula) {
  const effect = effects.byId.get(id);
  if (!effect) return null;
  const others = effect.confused_with.map((one) => titleOf(effects, one)).join(", ");
  const parameters = [...effect.parameters, ...effect.shape_parameters];
  return h("dl", { class: "facts" },
    h("dt", {}, "Formula"),
    h("dd", {}, formula(effect.formula)),
    h("dt", {}, "Leaves in the residual"),
    h("dd", {}, effect.signature),
    h("dt", {}, "Parameters"),
    h("dd", {}, parameters.map((one) => h("div", {}, h("code", {}, one.name), ` ${one.description}${one.unit === "-" ? "" : ` (${one.unit})`}`))),
    others ? [h("dt", {}, "Confused with"), h("dd", {}, others)] : null,
    h("dt", {}, "Sources"),
    h("dd", {}, effect.sources.join("; ")),
  );
}

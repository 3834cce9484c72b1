// The catalogue of effects, read once; names of effects and joints.

import { get, once } from "./api.js";
import { h } from "./dom.js";

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
  if (!choice.joints.length || (all.length > 1 && choice.joints.length === all.length)) return "all joints";
  return choice.joints.join(", ");
}

/** An effect and its place, in words. */
export function choiceInWords(effects, choice, all = []) {
  return `${titleOf(effects, choice.effect)} on ${placeOf(effects, choice, all)}`;
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

// Cards of a diagnosis's findings: sentence, evidence figure, errors before and after, rivals.

import { placeOf, shapeInWords, titleOf } from "./catalogue.js";
import { addButton } from "./candidates.js";
import { h } from "./dom.js";
import { evidenceOf } from "./evidence.js";
import { percent, pValue } from "./format.js";

/** One card for each effect that the data ask for; null where there is none. */
export function effectCards(model, result, add, signal) {
  const found = result.candidates.filter((one) => one.significant);
  if (!found.length) return null;
  return h("div", { class: "cards", id: "cards" }, found.map((one) => card(model, one, add, signal)));
}

function card(model, one, add, signal) {
  const name = one.question ? one.title : titleOf(model.effects, one.effect);
  const title = `${name} on ${placeOf(model.effects, one, model.joints)}`;
  const shape = shapeInWords(model.effects, one);
  const { words, figure, about } = evidenceOf(model, one, signal);
  return h("article", { class: "card", "data-effect": one.effect, "aria-label": title },
    h("div", { class: "card-head" }, h("h3", {}, title, shape ? h("small", { class: "note" }, ` ${shape}`) : null), addButton(model, one, name, add)),
    beforeAndAfter(one),
    words,
    figure,
    h("details", {}, h("summary", {}, "What this effect is"), about),
  );
}

/** Two bars on one scale: the error on its joints without the effect, and with it. */
function beforeAndAfter(one) {
  if (one.error_before === null || one.error_after === null) return null;
  const bar = (words, value, css) => [
    h("span", {}, words),
    h("span", { class: "share" }, h("span", { class: `fill ${css}`, style: { width: `${(100 * value / Math.max(one.error_before, one.error_after, 1e-12)).toFixed(1)}%` } })),
    h("data", { value }, percent(value)),
  ];
  return h("div", { class: "before-after", title: `relative error on blocks of time that the fit leaves out; p ${pValue(one.p_value)}` },
    bar("without it", one.error_before, ""),
    bar("with it", one.error_after, "good"),
  );
}

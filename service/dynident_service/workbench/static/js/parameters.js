// The base parameters of a model: how sure they are, what belongs together, which are essential.

import { get } from "./api.js";
import { kindInWords, placeOf, titleOf } from "./catalogue.js";
import { h, numeric, put, right, row, table } from "./dom.js";
import { number, percent } from "./format.js";
import { pressed, problemBox } from "./problem.js";

/** All parameters, by effect. */
export function parametersSection(model, signal) {
  const { parameters, dependence } = model.result;
  return h(
    "section",
    { id: "parameters", "aria-labelledby": "parameters-title" },
    h("h2", { id: "parameters-title" }, `Base parameters (${parameters.length})`),
    parametersTable(model, "Base parameters", parameters),
    shapesTable(model),
    together(dependence),
    essentialPart(model, signal),
  );
}

function parametersTable(model, caption, parameters) {
  const head = ["parameter", "link or joint", right("value"), right("standard deviation"), right("95 % interval"), "unit", right("relative"), "determined", "in standard parameters"];
  const rowOf = (one) =>
    row([
      h("code", {}, one.name),
      one.link || "–",
      numeric(number(one.value, 4), one.value),
      numeric(number(one.standard_deviation, 2), one.standard_deviation),
      { class: "n", text: one.interval[0] === null ? "–" : `${number(one.interval[0])} to ${number(one.interval[1])}` },
      one.unit,
      numeric(percent(one.relative_standard_deviation, 2)),
      judged(one),
      { class: "grouping", text: h("code", {}, one.grouping) },
    ]);
  const rows = byEffect(parameters).map(([effect, own]) => [
    h("tr", { class: "group" }, h("th", { scope: "rowgroup", colspan: head.length }, titleOf(model.effects, effect))),
    own.map(rowOf),
  ]);
  return table(caption, head, rows);
}

/** [effect, its parameters] in the order in which effects are first met. */
function byEffect(parameters) {
  const found = new Map();
  for (const one of parameters) found.set(one.effect, [...(found.get(one.effect) ?? []), one]);
  return [...found];
}

const SHAPES_JUDGED = {
  determined: ["ok", "✓ determined"],
  uncertain: ["warning", "! uncertain"],
  not_determined: ["warning", "✕ not determined"],
  at_edge: ["warning", "! at the edge"],
  elsewhere: ["warning", "! elsewhere in the data"],
  chosen: ["plain", "chosen"],
  not_looked_at: ["plain", "not looked at"],
};

/** The constants inside the effects' columns, with their intervals or why there is none. */
function shapesTable(model) {
  const constants = model.result.shape_constants ?? [];
  if (!constants.length) return null;
  const head = ["constant", "effect", "joint", right("value"), right("standard deviation"), right("95 % interval"), "unit", "determined"];
  const rows = constants.map((one) => {
    const [kind, text] = SHAPES_JUDGED[one.judgement] ?? SHAPES_JUDGED.not_looked_at;
    return row([
      h("span", { title: one.description }, h("code", {}, one.name)),
      titleOf(model.effects, one.effect),
      placeOf(model.effects, one, model.joints),
      numeric(kindInWords(model.effects, one.effect, one.name, one.value) ?? number(one.value, 4), one.value),
      numeric(number(one.standard_deviation, 2), one.standard_deviation),
      { class: "n", text: one.interval === null ? "–" : `${number(one.interval[0], 4)} to ${number(one.interval[1], 4)}` },
      one.unit,
      h("span", {}, h("span", { class: `mark ${kind}` }, text), one.note ? h("small", { class: "note" }, h("br"), one.note) : null),
    ]);
  });
  return table("Shape constants", head, rows);
}

const JUDGED = {
  determined: ["ok", "✓ determined"],
  uncertain: ["warning", "! uncertain"],
  zero_in_interval: ["plain", "0 in interval"],
};

/** What the interval says of a parameter; how it stands to the surest one for who asks. */
function judged(one) {
  const [kind, text] = JUDGED[one.judgement] ?? (one.well_identified ? JUDGED.determined : JUDGED.uncertain);
  const title = one.times_smallest ? `relative standard deviation ${number(one.times_smallest, 2)} times that of the surest parameter (§12.7: below 10)` : "";
  return h("span", { class: `mark ${kind}`, title }, text);
}

function together(sentences) {
  if (!sentences.length) return null;
  return h("details", {}, h("summary", {}, `Determined only together: ${sentences.length}`), h("ul", { id: "together" }, sentences.map((one) => h("li", {}, one))));
}

/** Backward elimination on demand: it takes no data, so no job. */
function essentialPart(model, signal) {
  const found = h("div", { id: "essential" });
  const button = h("button", { type: "button", onclick: () => find() }, "Essential parameters");
  const find = async () => {
    await pressed(button, async () => {
      put(found, essentialFound(model, await get(`/identifications/${model.id}/essential`, {}, signal)));
    }, (error) => put(found, problemBox(error)), signal);
  };
  return [h("p", { class: "actions" }, button, h("span", { class: "note" }, "takes out what the data do not show, one by one, and shows the errors along the way")), found];
}

function essentialFound(model, path) {
  const rows = path.steps.map((one) =>
    row([h("code", {}, one.name), numeric(percent(one.relative_standard_deviation, 2), one.relative_standard_deviation), numeric(number(one.p_value, 2), one.p_value),
      numeric(percent(one.residual.relative_total), one.residual.relative_total), numeric(percent(one.validation?.relative_total), one.validation?.relative_total)]),
  );
  const head = ["taken out", right("relative deviation"), right("p"), right("fit"), right("held out")];
  return [
    h("p", {}, path.reason),
    rows.length ? table("Backward elimination", head, rows) : null,
    parametersTable(model, "Essential parameters", path.parameters),
  ];
}

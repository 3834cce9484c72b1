// Section of base parameters: uncertainty, groups, essential ones, correlations.

import { get } from "./api.js";
import { h, put, section } from "./dom.js";
import { orSay, pressed, problemBox } from "./problem.js";
import { shownTable } from "./tables.js";

/** All parameters, by effect, and the constants inside the effects' columns. */
export function parametersSection(model, signal) {
  const { parameters, dependence } = model.result;
  const found = h("div", { id: "parameters" }, h("p", { class: "note" }, "Loading …"));
  const read = () => orSay(found, async () => {
    const tables = await model.tables(["parameters", "shapes"], signal);
    put(found, tables.map((one) => shownTable(one)));
  }, signal, read);
  read();
  return section("parameters", `Base parameters (${parameters.length})`, found, together(dependence), essentialPart(model, signal));
}

function together(sentences) {
  if (!sentences.length) return null;
  return h("details", {}, h("summary", {}, `Determined only together: ${sentences.length}`), h("ul", { id: "together" }, sentences.map((one) => h("li", {}, one))));
}

/** Backward elimination on demand: it takes no data, so no job. */
function essentialPart(model, signal) {
  const found = h("div", { id: "essential" });
  const find = async () => {
    const { reason, tables } = await get(`/identifications/${model.id}/essential`, {}, signal);
    put(found, h("p", {}, reason), tables.map((one) => shownTable(one)));
  };
  const button = h("button", { type: "button", onclick: () => pressed(button, find, (error) => put(found, problemBox(error)), signal) }, "Essential parameters");
  return [h("p", { class: "actions" }, button, h("span", { class: "note" }, "removes the parameters that the data do not determine, one by one, and shows the errors of each step")), found];
}

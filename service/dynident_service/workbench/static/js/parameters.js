// The base parameters of a model.

import { h, numeric, row, table } from "./dom.js";
import { number, percent } from "./format.js";
import { titleOf } from "./catalogue.js";

/** All parameters, folded away until somebody wants them. */
export function parametersSection(model) {
  const { parameters } = model.result;
  const head = ["parameter", "effect", right("value"), right("standard deviation"), "unit", right("relative"), "well identified", "in standard parameters"];
  const rows = parameters.map((one) =>
    row([
      h("code", {}, one.name),
      titleOf(model.effects, one.effect),
      numeric(number(one.value, 4), one.value),
      numeric(number(one.standard_deviation, 2), one.standard_deviation),
      one.unit,
      numeric(percent(one.relative_standard_deviation, 2)),
      one.well_identified ? h("span", { class: "mark ok" }, "✓ yes") : h("span", { class: "mark warning" }, "no"),
      h("code", {}, one.grouping),
    ]),
  );
  return h(
    "section",
    {},
    h("details", {}, h("summary", {}, h("h2", {}, `Base parameters (${parameters.length})`)), table("Base parameters", head, rows)),
  );
}

function right(text) {
  return { text, class: "n" };
}

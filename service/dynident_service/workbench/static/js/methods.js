// Names and descriptions of identification methods, from the contract.

import { choicesOf, choicesOfQuery, fieldsOf } from "./schema.js";

/** What no prior is called, and what it is for. */
export const NO_PRIOR = ["", "none", "Only the data count."];

/** Of each choice of an identification its [value, name]; and the validations and the formats of exports that there are. */
export async function methods() {
  const exports = choicesOfQuery("/v1/identifications/{identification_id}/export", "format");
  const [fields, { kind }] = await Promise.all([fieldsOf("IdentificationRequest"), fieldsOf("ValidationRequest")]);
  const lists = Object.fromEntries(["model", "strategy", "steps", "estimator", "prior"].map((name) => [name, [...(name === "prior" ? [NO_PRIOR] : []), ...choicesOf(fields[name])]]));
  return { lists, validations: kind["x-choices"], exports: await exports };
}

/** A request's method in words. */
export function methodInWords({ lists }, request) {
  const named = (list, value) => list.find(([known]) => known === (value?.name ?? value ?? ""))?.[1] ?? value;
  const strategy = request.strategy === "sequential" ? named(lists.steps, request.steps) : named(lists.strategy, request.strategy);
  const prior = request.prior ? `, prior: ${named(lists.prior, request.prior)}` : "";
  return `${named(lists.model, request.model)} model, ${strategy}, ${named(lists.estimator, request.estimator)}${prior}`;
}

// Reads the contract: fields of a request, their words and choices.

import { once, whole } from "./api.js";

const contract = once(() => whole("/openapi.json"));

/** The fields of a body of the contract, by their names: { description, default, enum, "x-choices", … }. */
export async function fieldsOf(body) {
  return (await schemas())[body].properties;
}

/** What a field is one of: [name, what people call it] of each. */
export function choicesOf(field) {
  return field["x-choices"].map((one) => [one.name, one.label]);
}

/** The same of a parameter in the query of an address that is read. */
export async function choicesOfQuery(path, name) {
  const { parameters } = (await contract()).paths[path].get;
  return choicesOf(parameters.find((one) => one.name === name).schema);
}

/** Of a field that takes a name or an object with options: the fields of these, by the name; not of names without. */
export async function optionsOf(body, id) {
  const all = await schemas();
  const kinds = (all[body].properties[id].anyOf ?? []).filter((one) => one.$ref).map((one) => all[one.$ref.split("/").pop()].properties);
  return new Map(kinds.map(({ name, ...options }) => [name.const ?? name.enum[0], options]));
}

async function schemas() {
  return (await contract()).components.schemas;
}

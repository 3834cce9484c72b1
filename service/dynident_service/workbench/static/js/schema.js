// What a request takes, as the contract says it: its fields, their words, and what each is one of.

import { whole } from "./api.js";

let reading = null;

/** The fields of a body of the contract, by their names: { description, default, enum, "x-choices", … }. */
export async function fieldsOf(body) {
  return (await schemas())[body].properties;
}

/** Of a field that takes a name or an object with options: the fields of these, by the name; not of names without. */
export async function optionsOf(body, id) {
  const all = await schemas();
  const kinds = (all[body].properties[id].anyOf ?? []).filter((one) => one.$ref).map((one) => all[one.$ref.split("/").pop()].properties);
  return new Map(kinds.map(({ name, ...options }) => [name.const ?? name.enum[0], options]));
}

async function schemas() {
  reading ??= whole("/openapi.json").catch((error) => {
    reading = null;
    throw error;
  });
  return (await reading).components.schemas;
}

// What a request takes, as the contract says it: its fields, their words, and what each is one of.

import { whole } from "./api.js";

let reading = null;

/** The fields of a body of the contract, by their names: { description, default, enum, "x-choices", … }. */
export async function fieldsOf(body) {
  reading ??= whole("/openapi.json").catch((error) => {
    reading = null;
    throw error;
  });
  return (await reading).components.schemas[body].properties;
}

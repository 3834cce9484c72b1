// Form controls built from the fields of a request in the contract (labels, choices, ranges).

import { field, h, select } from "./dom.js";

const LONGEST_LABEL = 42;
const AS_USUAL = ["", "default", ""];

/**
 * Controls for those of `fields` that a number, a word, a mark or a list can say; `given` are values to begin
 * with, `none` is what choosing nothing is called, `longestLabel` how long a description may be that stands as the label of a choice.
 */
export function controls(fields, { but = [], given = {}, pointer = "", prefix = "", none = AS_USUAL, longestLabel = LONGEST_LABEL } = {}) {
  return Object.entries(fields)
    .filter(([id, schema]) => !but.includes(id) && makerOf(schema))
    .map(([id, schema]) => control(id, schema, { given: given[id], pointer: `${pointer}/${id}`, prefix, none, longestLabel }));
}

/** A control of one field: { id, element, input, read }. */
function control(id, schema, { given, pointer, prefix, none, longestLabel }) {
  const made = makerOf(schema)(schema, given ?? schema.default ?? null, { id: `${prefix}${id}`, name: id }, none);
  const unit = schema["x-unit"];
  const words = (schema.description ?? "").replace(`, in ${unit}`, "");
  // Beneath a choice stands what the chosen one is for.
  const label = made.hint !== undefined && words && words.length <= longestLabel ? words : schema["x-label"] ?? labelOf(id);
  const element = field(unit ? `${label} (${unit})` : label, made.input, { pointer, hint: made.hint ?? (words === label ? "" : words) });
  element.title = words;
  made.shown?.(element.querySelector("small"));
  return { id, element, input: made.input, read: made.read, asked: (value) => value !== undefined && (given !== undefined || !same(value, schema.default ?? null)) };
}

/** What the controls say, without what the contract has by itself. */
export function said(all) {
  return Object.fromEntries(all.map((one) => [one.id, one]).filter(([, one]) => one.asked(one.read())).map(([id, one]) => [id, one.read()]));
}

/** Of controls those with these ids, in this order, and the others. */
export function sorted(all, first) {
  return [first.flatMap((id) => all.filter((one) => one.id === id)), all.filter((one) => !first.includes(one.id))];
}

function labelOf(id) {
  const words = id.replaceAll("_", " ");
  return words[0].toUpperCase() + words.slice(1);
}

function makerOf(schema) {
  if (schema["x-choices"]) return choice;
  const { type, items, prefixItems } = plain(schema);
  if (type === "number" || type === "integer") return number;
  if (type === "boolean") return mark;
  if (type === "object" && plain(schema).additionalProperties?.type === "number") return pairs;
  return type === "array" && ["number", "integer", "string"].includes((items ?? prefixItems?.[0])?.type) ? list : null;
}

/** The part of a schema that is not null. */
function plain(schema) {
  return (schema.anyOf ?? [schema]).find((one) => one.type !== "null");
}

function mayBeNull(schema) {
  return (schema.anyOf ?? []).some((one) => one.type === "null");
}

/** One of several, with what the chosen one is for beneath it. */
function choice(schema, value, props, none) {
  const all = schema["x-choices"].map((one) => [one.name, one.label, one.words]);
  if (mayBeNull(schema)) all.unshift(none);
  const wordsOf = (name) => all.find(([known]) => known === name)?.[2] || "\u00a0";
  const name = value?.name ?? value ?? "";
  let note = null;
  const input = select(all, name, (chosen) => { if (note) note.textContent = wordsOf(chosen); }, props);
  return { input, read: () => input.value || null, hint: wordsOf(name), shown: (made) => { note = made; } };
}

function number(schema, value, props) {
  const { type, minimum, exclusiveMinimum, maximum } = plain(schema);
  const range = { min: minimum ?? exclusiveMinimum, max: maximum, step: type === "integer" ? "1" : "any" };
  const input = h("input", { type: "number", value: typeof value === "number" ? value : "", ...range, ...props });
  return { input, read: () => (input.value === "" ? (schema.default ?? null) : Number(input.value)) };
}

function mark(schema, value, props) {
  const input = h("input", { type: "checkbox", checked: Boolean(value), ...props });
  return { input, read: () => input.checked };
}

/** Values one behind another; a text with a comma in it, such as a foot with a point, is apart from others by a semicolon. */
function list(schema, value, props) {
  const { items } = plain(schema);
  const apart = (text) => (text.includes("@") ? ";" : /[,;]/);
  const input = h("input", { value: (value ?? []).join(String(value).includes("@") ? "; " : ", "), placeholder: "one, another", ...props });
  const each = items?.type === "string" ? String : Number;
  const parts = () => input.value.split(apart(input.value)).map((part) => part.trim()).filter(Boolean).map(each);
  return { input, read: () => (parts().length ? parts() : (schema.default ?? null)) };
}

/** Numbers by name: "Ia3 = 0.2, Fc1 = 3". */
function pairs(schema, value, props) {
  const input = h("input", { value: Object.entries(value ?? {}).map((one) => one.join(" = ")).join(", "), placeholder: "name = number, another = …", ...props });
  const parts = () => input.value.split(/[,;]/).filter((part) => part.trim()).map((part) => part.split("=").map((word) => word.trim()));
  return { input, read: () => Object.fromEntries(parts().map(([name, number]) => [name, Number(number || NaN)])) };
}

function same(a, b) {
  return JSON.stringify(a) === JSON.stringify(b);
}

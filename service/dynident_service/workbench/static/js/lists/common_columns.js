// Columns that several lists of resources share.

import { h } from "../dom.js";
import { moment } from "../format.js";
import { labelsButton, tagChips } from "./labels.js";

/** A column whose cells say what it is sorted by. */
export function plainColumn(id, name, value) {
  return { id, name, value, cell: value };
}

/** A column of figures: `value(item)` as `words(value)`; they are not searched in. */
export function figureColumn(id, name, value, words = String) {
  return { id, name, right: true, value, text: () => "", cell: (one) => words(value(one)) };
}

/** When it was made or asked for. */
export function dateColumn(name = "date") {
  const words = (one) => moment(one.created_at);
  return { id: "date", name, value: (one) => one.created_at, text: words, cell: (one) => h("time", { datetime: one.created_at }, words(one)) };
}

/** Its tags, and a button that changes what it is called and filed under; `before` stands before that. */
export function labelColumns(path, changed, before = () => null) {
  return [
    { id: "tags", name: "tags", value: (one) => one.tags.join(" "), cell: tagChips },
    { id: "acts", name: "", cell: (one) => [before(one), labelsButton(`${path}/${one.id}`, one, changed(one))] },
  ];
}

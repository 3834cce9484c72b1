// Shows tables that the service words (cells with marks), as on the command line.

import { h, right, row, table } from "./dom.js";

/** A table of an answer; rows that belong together stand under their heading. */
export function shownTable({ title, columns, rows, groups }, props = {}) {
  const lines = rows.map((cells, k) => [
    groups.length && groups[k] !== groups[k - 1] ? h("tr", { class: "group" }, h("th", { scope: "rowgroup", colspan: columns.length }, groups[k])) : null,
    row(cells.map((cell, at) => ({ class: columns[at].figures ? "n" : null, text: shownCell(cell) }))),
  ]);
  return table(title, columns.map((one) => (one.figures ? right(one.word) : one.word)), lines, props);
}

function shownCell({ text, value, mark, note }) {
  const words = value === null ? text : h("data", { value }, text);
  return [mark ? h("span", { class: `mark ${mark}` }, words) : words, note ? h("small", { class: "note" }, h("br"), note) : null];
}

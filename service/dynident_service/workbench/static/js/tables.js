// Shows tables that the service words (cells with marks), as on the command line.

import { h, right, row, table } from "./dom.js";

const SHORT = 10; // Units and the like are not broken into lines.

/**
 * A table of an answer and its notes; rows that belong together stand under their heading. What only a page has comes
 * besides: `wrap[column](content, k)` makes a cell's content a link or a button, `more` are further columns
 * [head, cell(k)], `rowProps(k)` attributes of a row, `below(k)` a row under it; `content(cell, column)` shows a cell.
 */
export function shownTable({ title, columns, rows, groups, notes = [], marked_rows = [] }, props = {}, { wrap = {}, more = [], rowProps = () => ({}), below = () => null, content = shownCell } = {}) {
  const cellOf = (cell, at, k) => ({ class: columns[at].figures ? "n" : cell.text.length < SHORT ? "short" : null, text: wrap[at] ? wrap[at](content(cell, at), k) : content(cell, at) });
  const ofJoint = columns.findIndex((one) => one.word === "joint");
  const lines = rows.map((cells, k) => [
    groups.length && groups[k] !== groups[k - 1] ? h("tr", { class: "group" }, h("th", { scope: "rowgroup", colspan: columns.length + more.length }, groups[k])) : null,
    row([...cells.map((cell, at) => cellOf(cell, at, k)), ...more.map(([, cell]) => cell(k))], { class: marked_rows.includes(k) ? "pick" : null, "data-joint": cells[ofJoint]?.text, ...rowProps(k) }),
    below(k),
  ]);
  const heads = columns.map((one) => (one.figures ? right(one.word) : one.word));
  return [table(title, [...heads, ...more.map(([head]) => head)], lines, props), notes.length ? h("p", { class: "note" }, notes.join(" ")) : null];
}

/** A table that is folded away under its title; nothing where there is none. */
export function foldedTable(shown, props = {}, extras = {}, open = false) {
  return shown ? h("details", { open, class: "folded" }, h("summary", {}, shown.title), shownTable(shown, props, extras)) : null;
}

/** The tables of an answer by their names. */
export function byName({ tables }) {
  return Object.fromEntries(tables.map((one) => [one.name, one]));
}

/** Some columns of a table, by their places. */
export function columnsOf(shown, places) {
  return { ...shown, columns: places.map((at) => shown.columns[at]), rows: shown.rows.map((cells) => places.map((at) => cells[at])) };
}

function shownCell({ text, value, mark, note }) {
  const words = value === null ? text : h("data", { value }, text);
  return [mark ? h("span", { class: `mark ${mark}` }, words) : words, note ? h("small", { class: "note" }, h("br"), note) : null];
}

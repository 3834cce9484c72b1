// Findings of a diagnosis as cards, the table of all ranked effects, and buttons that add an effect.

import { h, put } from "./dom.js";
import { evidenceOf } from "./evidence.js";
import { byName, foldedTable, shownTable } from "./tables.js";

const [EFFECT, JOINTS, BEFORE, AFTER, DROP, P] = [1, 2, 3, 4, 5, 6]; // columns of the table of candidates

/** Every family that was tried, best first; a row opens to its evidence. */
export function candidatesTable(model, diagnosis, add, signal) {
  const { result } = diagnosis;
  const { candidates: table, outcomes } = byName(diagnosis);
  if (!table) return null;
  const most = Math.max(...result.candidates.map((one) => one.error_drop ?? 0), 1e-9);
  // The evidence stands in the row that opens below.
  const columns = table.columns.slice(0, -1).map((one, at) => ({ ...one, figures: one.figures && at !== DROP }));
  const shown = { ...table, columns, rows: table.rows.map((cells) => cells.slice(0, -1)) };
  const evidence = table.rows.map(() => h("tr", { class: "evidence", hidden: true }, h("td", { colspan: shown.columns.length + 1 })));
  const toggle = (opener, k) => {
    const open = evidence[k].toggleAttribute("hidden") === false;
    opener.setAttribute("aria-expanded", String(open));
    if (!open || evidence[k].dataset.filled) return;
    evidence[k].dataset.filled = "yes";
    const one = result.candidates[k];
    const { figure, about } = evidenceOf(model, one, signal);
    put(evidence[k].firstChild, h("p", {}, table.rows[k].at(-1).text), otherPlaces(outcomes, result.outcomes, one.effect), h("div", { class: "two" }, figure, about));
  };
  const opener = ([title, ...note], k) => [h("button", { type: "button", class: "plain", "aria-expanded": "false", onclick: (event) => toggle(event.currentTarget, k) }, title), note];
  const bar = (content, k) => {
    const { error_drop: drop, significant } = result.candidates[k];
    return h("span", { class: "share" }, h("span", { class: significant ? "fill good" : "fill", style: { width: `${((100 * Math.max(0, drop ?? 0)) / most).toFixed(1)}%` } }), content);
  };
  return shownTable(shown, { id: "candidates" }, {
    wrap: { [EFFECT]: opener, [DROP]: bar },
    more: [["", (k) => addButton(model, result.candidates[k], table.rows[k], add)]],
    rowProps: (k) => ({ "data-effect": result.candidates[k].effect }),
    below: (k) => evidence[k],
  });
}

/** One card for each effect that the data ask for; null where there is none. */
export function findingCards(model, diagnosis, add, signal) {
  const { candidates: table } = byName(diagnosis);
  const cards = diagnosis.result.candidates.map((one, k) => one.significant && card(model, one, table, table.rows[k], add, signal));
  return cards.some(Boolean) ? h("div", { class: "cards", id: "cards" }, cards) : null;
}

function card(model, one, { columns }, cells, add, signal) {
  const title = `${cells[EFFECT].text} on ${cells[JOINTS].text}`;
  const { figure, about } = evidenceOf(model, one, signal);
  const most = Math.max(one.error_before ?? 0, one.error_after ?? 0, 1e-12);
  // Two bars on one scale: the error on its joints without the effect, and with it.
  const bar = (at, css) => [
    h("span", {}, columns[at].word),
    h("span", { class: "share" }, h("span", { class: `fill ${css}`, style: { width: `${((100 * cells[at].value) / most).toFixed(1)}%` } })),
    h("data", { value: cells[at].value }, cells[at].text),
  ];
  const known = cells[BEFORE].value !== null && cells[AFTER].value !== null;
  return h("article", { class: "card", "data-effect": one.effect, "aria-label": title },
    h("div", { class: "card-head" }, h("h3", {}, title, cells[EFFECT].note ? h("small", { class: "note" }, ` ${cells[EFFECT].note}`) : null), addButton(model, one, cells, add)),
    known ? h("div", { class: "before-after", title: `${columns[P].word} ${cells[P].text}` }, bar(BEFORE, ""), bar(AFTER, "good")) : null,
    h("p", { class: one.equivalent.length ? "box warning" : null }, cells.at(-1).text),
    figure,
    h("details", {}, h("summary", {}, "What this effect is"), about),
  );
}

/** Adds the effect, or says why it cannot be added. */
function addButton(model, one, cells, add) {
  if (one.runs.length && model.diagnosis.result.changes?.some((change) => change.effect === one.effect)) return h("span", { class: "note" }, "since the baseline");
  if (model.contains(one)) return h("span", { class: "note" }, "in the model");
  const choice = { effect: one.effect, joints: one.joints, shape_parameters: one.shape_parameters, runs: one.runs };
  const said = h("div");
  const text = one.significant ? "Add" : "Add anyway";
  const warning = one.significant ? null : "Not a finding: add it only if you know that the robot has it.";
  return [h("button", { type: "button", class: "small", title: warning, "aria-label": `${text}: ${cells[EFFECT].text} on ${cells[JOINTS].text}`, onclick: () => add([choice], said) }, text), said];
}

/** Why, or why not, on every joint: folded away, since most rows say the same. */
function otherPlaces(table, outcomes, effect) {
  const own = outcomes.flatMap((one, k) => (one.effect === effect ? [k] : []));
  if (own.length < 2) return null;
  const title = `${table.title}: ${table.groups[own[0]]} (${own.length})`;
  return foldedTable({ ...table, title, groups: [], rows: own.map((k) => table.rows[k]) });
}

// Table of the ranked effects of a diagnosis, with evidence figures and buttons that add an effect.

import { placeOf, titleOf } from "./catalogue.js";
import { figures, h, listed, put } from "./dom.js";
import { evidenceOf } from "./evidence.js";
import { number, percent, pValue } from "./format.js";
import { shownTable } from "./tables.js";

const BAR = 5; // the column of the drop, which is drawn as well

/** Every family that was tried, best first; a row opens to its evidence. */
export function candidatesTable(model, { result, tables }, add, signal) {
  const table = tables.find((one) => one.name === "candidates");
  if (!table) return null;
  const most = Math.max(...result.candidates.map((one) => one.error_drop ?? 0), 1e-9);
  // The evidence stands in the row that opens below.
  const columns = table.columns.slice(0, -1).map((one, at) => ({ ...one, figures: one.figures && at !== BAR }));
  const shown = { ...table, columns, rows: table.rows.map((cells) => cells.slice(0, -1)) };
  const evidence = result.candidates.map(() => h("tr", { class: "evidence", hidden: true }, h("td", { colspan: shown.columns.length + 1 })));
  const titles = table.rows.map((cells) => cells[1].text);
  const toggle = (opener, k) => {
    const open = evidence[k].toggleAttribute("hidden") === false;
    opener.setAttribute("aria-expanded", String(open));
    if (open && !evidence[k].dataset.filled) {
      evidence[k].dataset.filled = "yes";
      fillEvidence(evidence[k].firstChild, model, result.candidates[k], result, signal);
    }
  };
  const opener = ([title, ...note], k) => [h("button", { type: "button", class: "plain", "aria-expanded": "false", onclick: (event) => toggle(event.currentTarget, k) }, title), note];
  const bar = (content, k) => {
    const { error_drop: drop, significant } = result.candidates[k];
    return h("span", { class: "share" }, h("span", { class: significant ? "fill good" : "fill", style: { width: `${((100 * Math.max(0, drop ?? 0)) / most).toFixed(1)}%` } }), content);
  };
  return shownTable(shown, { id: "candidates" }, {
    wrap: { 1: opener, [BAR]: bar },
    more: [["", (k) => addButton(model, result.candidates[k], titles[k], add)]],
    rowProps: (k) => ({ "data-effect": result.candidates[k].effect }),
    below: (k) => evidence[k],
  });
}

/** Adds the effect, or says why it cannot be added. */
export function addButton(model, one, title, add) {
  if (one.runs.length && model.diagnosis.result.changes?.some((change) => change.effect === one.effect)) return h("span", { class: "note" }, "since the baseline");
  if (model.contains(one)) return h("span", { class: "note" }, "in the model");
  const choice = { effect: one.effect, joints: one.joints, shape_parameters: one.shape_parameters, runs: one.runs };
  const where = placeOf(model.effects, one, model.joints);
  const said = h("div");
  const text = one.significant ? "Add" : "Add anyway";
  const warning = one.significant ? null : "not significant on held-out data";
  return [h("button", { type: "button", class: "small", title: warning, "aria-label": `${text}: ${title} on ${where}`, onclick: () => add([choice], said) }, text), said];
}

function fillEvidence(cell, model, one, result, signal) {
  const { words, figure, about } = evidenceOf(model, one, signal);
  const doubt = `Not a finding (t = ${number(one.t_value)}, p = ${pValue(one.p_value)}): add it only if you know that the robot has it.`;
  put(cell, words, one.significant ? null : h("p", {}, doubt), otherPlaces(model, one, result), h("div", { class: "two" }, figure, about));
}

/** Why, or why not, on every joint: folded away, since most rows say the same. */
function otherPlaces(model, one, result) {
  const outcomes = (result.outcomes ?? []).filter((outcome) => outcome.effect === one.effect);
  if (outcomes.length < 2) return null;
  const columns = [
    ["where", (outcome) => placeOf(model.effects, outcome, model.joints)],
    figures("drop, held out", (outcome) => outcome.error_drop, (value) => percent(value)),
    ["why, or why not", (outcome) => outcome.reason.text],
  ];
  return h("details", {}, h("summary", {}, `Why, or why not, on each joint (${outcomes.length})`), listed(`${titleOf(model.effects, one.effect)}: why, or why not`, columns, outcomes));
}

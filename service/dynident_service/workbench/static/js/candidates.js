// Table of the ranked effects of a diagnosis, with evidence figures and buttons that add an effect.

import { placeOf, shapeInWords, titleOf } from "./catalogue.js";
import { figures, h, listed, numeric, put, right, row, table } from "./dom.js";
import { evidenceOf } from "./evidence.js";
import { number, percent, pValue } from "./format.js";

const COLUMNS = 9;

/** Every family that was tried, best first; a row opens to its evidence. */
export function candidatesTable(model, result, add, signal) {
  if (!result.candidates.length) return null;
  const most = Math.max(...result.candidates.map((one) => one.error_drop ?? 0), 1e-9);
  const head = ["rank", "effect", "where", right("error (%)"), "drop, held out", right("p"), right("separable"), "why, or why not", ""];
  const rows = result.candidates.flatMap((one) => candidateRows(model, one, most, result, add, signal));
  const notes = "Errors are relative, of the given joints, on blocks of time that the fit leaves out; the model already contains everything that ranks above the effect. Separable: the share of the effect's columns that the model does not explain; near zero, these data cannot distinguish the effect from the model.";
  return [table("Ranked effects", head, rows, { id: "candidates" }), h("p", { class: "note" }, notes)];
}

function candidateRows(model, one, most, result, add, signal) {
  const evidence = h("tr", { class: "evidence", hidden: true }, h("td", { colspan: COLUMNS }));
  const title = one.question ? one.title : titleOf(model.effects, one.effect);
  const opener = h("button", { type: "button", class: "plain", "aria-expanded": "false", onclick: () => toggle() }, title);
  const toggle = () => {
    const open = evidence.toggleAttribute("hidden") === false;
    opener.setAttribute("aria-expanded", String(open));
    if (open && !evidence.dataset.filled) {
      evidence.dataset.filled = "yes";
      fillEvidence(evidence.firstChild, model, one, result, signal);
    }
  };
  const shape = shapeInWords(model.effects, one);
  const share = Math.max(0, one.error_drop ?? 0) / most;
  const cells = [
    { text: String(one.rank), scope: "row" },
    [opener, one.significant ? h("span", { class: "mark ok" }, " ✓ significant") : null, shape ? h("small", { class: "note" }, h("br"), shape) : null],
    placeOf(model.effects, one, model.joints),
    { class: "n", text: [percent(one.error_before), h("br"), "→ ", percent(one.error_after)] },
    h("span", { class: "share" }, h("span", { class: one.significant ? "fill good" : "fill", style: { width: `${(100 * share).toFixed(1)}%` } }), h("data", { value: one.error_drop ?? "" }, percent(one.error_drop))),
    numeric(pValue(one.p_value), one.p_value),
    numeric(percent(one.separability, 2), one.separability),
    reasonBrief(one),
    addButton(model, one, title, add),
  ];
  return [row(cells, { "data-effect": one.effect, class: one.significant ? "pick" : null }), evidence];
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

/** Why it is a finding or not, in a few words; the sentence is in the evidence. */
function reasonBrief(one) {
  if (!one.reason) return one.significant ? "accepted" : "not accepted";
  return h("span", { title: one.reason.text }, one.reason.brief);
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

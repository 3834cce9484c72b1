// Section "what is missing": run a diagnosis and add what it recommends.

import { get, patch, post } from "./api.js";
import { addByHand } from "./add_effect.js";
import { choiceInWords } from "./catalogue.js";
import { candidatesTable, findingCards } from "./candidates.js";
import { changesForm, changesTable } from "./changes.js";
import { nextBox } from "./design/proposals.js";
import { announce, h, put, section } from "./dom.js";
import { awaited } from "./jobs.js";
import { nextRung } from "./extended_model.js";
import { pressed, problemBox, showInForm } from "./problem.js";
import { byName, foldedTable, shownTable } from "./tables.js";

/** Follows the diagnosis; Diagnose asks for a new one. */
export function missingSection(model, signal) {
  const button = h("button", { type: "button", class: "main", id: "diagnose", onclick: () => runPressed(post("/diagnoses", { identification_id: model.id })) }, "Diagnose");
  const said = h("div");
  const body = h("div", { id: "diagnosis" });
  const add = (effects, from) => extend(model, effects, from ?? said, signal);

  const run = async (diagnosis) => {
    const found = await awaited("/diagnoses", await diagnosis, "Diagnosing", said, signal);
    model.setDiagnosis(found);
    const { title, notes } = byName(found).conclusion;
    announce([title, ...notes].join(" "));
  };
  const runPressed = (diagnosis) => pressed(button, () => run(diagnosis), (error) => put(said, problemBox(error)), signal);

  const follow = () => {
    const { diagnosis } = model;
    if (!diagnosis) return;
    if (diagnosis.status === "succeeded") put(body, whole(model, add, runPressed, signal));
    else runPressed(diagnosis);
  };
  model.addEventListener("diagnosis", follow);
  follow();
  // The click that led here has asked for it.
  const begin = () => {
    if (model.wantsDiagnosis && !model.diagnosis) button.click();
    model.wantsDiagnosis = false;
  };
  model.addEventListener("wanted", begin);
  begin();
  return section("missing", "What is missing",
    h("p", { class: "actions" }, button, h("span", { class: "note" }, "compares every effect of the catalogue with the residual of the model")),
    said,
    body,
    changesForm(model, async (asked) => runPressed(await post("/diagnoses", asked)), signal),
    addByHand(model, add),
  );
}

/** Add effects to a model and go to the new one. */
async function extend(model, effects, said, signal) {
  try {
    await nextRung(model, "extend", effects, said, signal);
  } catch (error) {
    const form = said.closest("form");
    if (signal.aborted) return;
    if (form) showInForm(form, said, error);
    else put(said, problemBox(error));
  }
}

/** The diagnosis of the model itself; that of one that it came from is folded away. */
function whole(model, add, run, signal) {
  if (model.diagnosis.request.identification_id === model.id) return shown(model, add, run, signal);
  return [
    h("p", {}, "Diagnose this model to see what is still missing."),
    h("details", {}, h("summary", {}, "The diagnosis of its parent model"), shown(model, add, run, signal)),
  ];
}

function shown(model, add, run, signal) {
  const { diagnosis } = model;
  const tables = byName(diagnosis);
  return [
    verdict(model, diagnosis.result, tables.conclusion, add, run),
    changesTable(diagnosis),
    findingCards(model, diagnosis, add, signal),
    candidatesTable(model, diagnosis, add, signal),
    tables.unknown ? shownTable(tables.unknown) : null,
    nextExperiment(model, signal),
    h("div", { id: "limits" }, foldedTable(tables.limits_map, {}, { content: limitCell })),
    foldedTable(tables.hidden),
  ];
}

/** A cell of the map of detection limits: its colour tells whether the usual size would have shown. */
function limitCell({ text, value, note }, column) {
  if (!column || !text) return text;
  const level = value === null ? "none" : value > 3 ? "far" : value > 1 ? "above" : value > 0.3 ? "near" : "below";
  return h("data", { value: value ?? "", class: `limit ${level}`, title: note }, text);
}

function verdict(model, result, { title, columns, rows, notes: [summary, ...others] }, add, run) {
  const said = h("div");
  const left = result.recommended.filter((one) => !model.contains(one));
  const items = rows.map(([effect, place, constants], k) => {
    const one = result.recommended[k];
    const button = model.contains(one)
      ? h("span", { class: "mark ok" }, "✓ in the model")
      : h("button", { type: "button", class: "small", onclick: () => add([one], said), "aria-label": `Add ${effect.text} on ${place.text}` }, "Add");
    return h("li", {}, h("strong", {}, effect.text), ` on ${[place.text, constants.text].filter(Boolean).join(", ")} `, button);
  });
  return h("div", { class: result.verdict === "adequate" ? "box good" : "box warning", id: "verdict", "data-verdict": result.verdict, "data-conclusion": result.conclusion?.code ?? "" },
    h("p", {}, h("strong", {}, `${title} `), summary),
    others.map((one) => h("p", {}, one)),
    items.length ? [h("p", {}, `${columns[0].word}:`), h("ol", {}, items)] : null,
    partQuestions(model, result, run),
    left.length ? h("p", {}, h("button", { type: "button", class: "main", id: "add-recommended", onclick: () => add(left, said) }, left.length > 1 ? `Add all ${left.length} recommended effects` : "Add the recommended effect")) : null,
    said,
  );
}

/** The questions whether the robot has a part; an answer is kept with the robot, and the model diagnosed again. */
function partQuestions(model, result, run) {
  const asked = new Map(result.recommended.filter((one) => one.question).map((one) => [one.question, model.effects.byId.get(one.effect)]));
  return [...asked].filter(([, effect]) => effect?.hardware).map(([question, { title, hardware: part }]) => {
    const said = h("span");
    const answer = (key) => async (event) => pressed(event.target, async () => {
      const robot = await get(`/robots/${model.identification.robot_id}`);
      await patch(`/robots/${robot.id}`, { [key]: [...robot[key], part] });
      await run(post("/diagnoses", { identification_id: model.id }));
    }, (error) => put(said, problemBox(error)));
    return h("p", { class: "actions", "data-part": part, role: "group", "aria-label": question }, `${title}: `,
      h("button", { type: "button", class: "small", onclick: answer("has") }, "the robot has it"), " ",
      h("button", { type: "button", class: "small", onclick: answer("has_not") }, "it has none"), said);
  });
}

/** The experiment that decides what is open; it is looked for when it is asked for. */
function nextExperiment(model, signal) {
  const { id, result: { next_experiment: next, doubts } } = model.diagnosis;
  if (!next) return doubts.length ? searchButton(model, id, doubts, signal) : null;
  const said = h("span", { class: "note" });
  const body = JSON.stringify(next.design, null, 1);
  const copy = () => navigator.clipboard.writeText(body).then(() => { said.textContent = " copied"; }, () => { said.textContent = " select the text below and copy it"; });
  return nextBox("Next experiment", next, h("details", {}, h("summary", {}, "Body for POST /v1/designs"), h("pre", {}, body), h("button", { type: "button", class: "small", onclick: copy }, "Copy"), said));
}

/** What asks for the motion that decides; the diagnosis is shown again with it. */
function searchButton(model, id, doubts, signal) {
  const said = h("span");
  const search = (event) => pressed(event.target, async () => {
    const { result } = await awaited("/next_experiments", await post(`/diagnoses/${id}/next_experiment`, {}), "Looking for a motion", said, signal);
    if (result.experiment) model.setDiagnosis(await get(`/diagnoses/${id}`, {}, signal));
    else put(said, " No motion within the robot's limits decides it.");
  }, (error) => put(said, problemBox(error)), signal);
  const questions = doubts.map((one) => h("li", {}, questionInWords(model, one)));
  return h("div", { id: "open-questions" }, h("p", {}, doubts.length === 1 ? "1 question is open:" : `${doubts.length} questions are open:`), h("ul", {}, questions),
    h("p", { class: "actions" }, h("button", { type: "button", class: "small", id: "next-experiment", onclick: search }, "Look for a motion that decides"), said));
}

/** What the data do not tell: which of several effects it is, or whether there is one. */
function questionInWords({ effects, joints }, { suspect, rivals }) {
  const [first, ...others] = [suspect, ...rivals].map((one) => choiceInWords(effects, one, joints));
  return others.length ? `Is it ${first}, or ${others.join(", or ")}?` : `Does the robot have this effect: ${first}?`;
}

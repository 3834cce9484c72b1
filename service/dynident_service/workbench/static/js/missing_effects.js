// Section "what is missing": run a diagnosis and add what it recommends.

import { get, patch, post } from "./api.js";
import { addByHand } from "./add_effect.js";
import { candidatesTable } from "./candidates.js";
import { changesForm, changesTable } from "./changes.js";
import { choiceInWords, findingTitle, placeOf, shapeInWords } from "./catalogue.js";
import { nextBox } from "./design/proposals.js";
import { announce, h, put, section } from "./dom.js";
import { detectionLimits } from "./detection_limits.js";
import { effectCards } from "./effect_cards.js";
import { awaited } from "./jobs.js";
import { nextRung } from "./extended_model.js";
import { pressed, problemBox, showInForm } from "./problem.js";
import { shownTable } from "./tables.js";

const HEADLINES = {
  adequate: "These data show no missing effect",
  missing_effect: "An effect is missing",
  unexplained: "Something is missing that the catalogue does not explain",
};

/** The headline of a diagnosis: where nothing was found, what that is worth. */
const headline = (result) => (result.conclusion && (result.verdict === "adequate" || result.conclusion.code === "cannot_tell") ? result.conclusion.headline : `${HEADLINES[result.verdict]}.`);

/** Follows the diagnosis; Diagnose asks for a new one. */
export function missingSection(model, signal) {
  const button = h("button", { type: "button", class: "main", id: "diagnose", onclick: () => runPressed(post("/diagnoses", { identification_id: model.id })) }, "Diagnose");
  const said = h("div");
  const body = h("div", { id: "diagnosis" });
  const add = (effects, from) => extend(model, effects, from ?? said, signal);

  const run = async (diagnosis) => {
    const found = await awaited("/diagnoses", await diagnosis, "Diagnosing", said, signal);
    model.setDiagnosis(found);
    announce(`${headline(found.result)} ${found.result.summary}`);
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
  const { result } = model.diagnosis;
  const tables = Object.fromEntries(model.diagnosis.tables.map((one) => [one.name, one]));
  return [
    verdict(model, result, add, run),
    changesTable(model.diagnosis),
    effectCards(model, result, add, signal),
    candidatesTable(model, model.diagnosis, add, signal),
    tables.unknown ? shownTable(tables.unknown) : null,
    nextExperiment(model, result),
    detectionLimits(model, result),
    tables.hidden ? h("details", {}, h("summary", {}, `${tables.hidden.title} (${tables.hidden.rows.length})`), shownTable(tables.hidden)) : null,
  ];
}

function verdict(model, result, add, run) {
  const said = h("div");
  const left = result.recommended.filter((one) => !model.contains(one));
  const items = result.recommended.map((one) => {
    const words = choiceInWords(model.effects, one, model.joints);
    const shape = shapeInWords(model.effects, one);
    const button = model.contains(one)
      ? h("span", { class: "mark ok" }, "✓ in the model")
      : h("button", { type: "button", class: "small", onclick: () => add([one], said), "aria-label": `Add ${words}` }, "Add");
    return h("li", {}, h("strong", {}, findingTitle(model, result, one)), ` on ${placeOf(model.effects, one, model.joints)}${shape ? `, ${shape}` : ""} `, button);
  });
  return h("div", { class: result.verdict === "adequate" && result.conclusion?.code !== "cannot_tell" ? "box good" : "box warning", id: "verdict", "data-verdict": result.verdict, "data-conclusion": result.conclusion?.code ?? "" },
    h("p", {}, h("strong", {}, `${headline(result)} `), result.summary),
    result.conclusion ? h("p", {}, h("strong", {}, "Next: "), result.conclusion.next_step) : null,
    items.length ? [h("p", {}, "Recommended, in this order:"), h("ol", {}, items)] : null,
    partQuestions(model, result, run),
    left.length ? h("p", {}, h("button", { type: "button", class: "main", id: "add-recommended", onclick: () => add(left, said) }, left.length > 1 ? `Add all ${left.length} recommended effects` : "Add the recommended effect")) : null,
    said,
  );
}

/** The questions whether the robot has a part; an answer is kept with the robot, and the model diagnosed again. */
function partQuestions(model, result, run) {
  const asked = new Map(result.recommended.filter((one) => one.question).map((one) => [one.question, model.effects.byId.get(one.effect)?.hardware]));
  return [...asked].filter(([, part]) => part).map(([question, part]) => {
    const said = h("span");
    const answer = (key) => async (event) => pressed(event.target, async () => {
      const robot = await get(`/robots/${model.identification.robot_id}`);
      await patch(`/robots/${robot.id}`, { [key]: [...robot[key], part] });
      await run(post("/diagnoses", { identification_id: model.id }));
    }, (error) => put(said, problemBox(error)));
    return h("p", { class: "actions", "data-part": part }, question.split(" Answer once")[0], " ",
      h("button", { type: "button", class: "small", onclick: answer("has") }, "Yes"), " ",
      h("button", { type: "button", class: "small", onclick: answer("has_not") }, "No"), said);
  });
}

function nextExperiment(model, result) {
  const next = result.next_experiment;
  if (!next) return null;
  const said = h("span", { class: "note" });
  const body = JSON.stringify(next.design, null, 1);
  const copy = () => navigator.clipboard.writeText(body).then(() => { said.textContent = " copied"; }, () => { said.textContent = " select the text below and copy it"; });
  return nextBox("Next experiment", next, h("details", {}, h("summary", {}, "Body for POST /v1/designs"), h("pre", {}, body), h("button", { type: "button", class: "small", onclick: copy }, "Copy"), said));
}

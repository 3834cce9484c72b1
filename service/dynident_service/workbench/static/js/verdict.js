// Section of the verdict: uses that a model is fit for, and the next step.

import { get } from "./api.js";
import { h, put, section } from "./dom.js";
import { identifyBy } from "./extended_model.js";
import { driftFigure } from "./ladder_figures.js";
import { address } from "./page_address.js";
import { orSay, pressed, problemBox } from "./problem.js";
import { inPageWords } from "./recordings/remedies.js";
import { byName, foldedTable } from "./tables.js";
import { goToTab } from "./tabs.js";

/** Asks the service for its verdict; the next click follows the diagnosis. */
export function verdictSection(model, signal) {
  const body = h("div", { id: "fitness" }, h("p", { class: "note" }, "Judging the model …"));
  const next = h("p", { class: "actions" });
  let found = null;
  const showNext = () => put(next, found && nextClick(model, found));
  const judge = () => orSay(body, async () => {
    found = await get(`/identifications/${model.id}/verdict`, {}, signal);
    put(body, judged(found, model, signal));
    showNext();
  }, signal, judge);
  model.addEventListener("diagnosis", showNext);
  model.addEventListener("validated", judge);
  judge();
  return section("fitness", "What it is fit for", body, next);
}

function judged(found, model, signal) {
  const fit = !found.stop && found.uses.every((one) => one.state === "yes");
  const { uses, drift } = byName(found);
  const words = (sentence) => inPageWords(sentence, found.remedies);
  return [
    h("div", { class: fit ? "box good" : "box warning", id: "fitness-summary" }, h("p", {}, inPageWords(found.summary, found.stop?.remedies))),
    // After a gross fault the uses mean nothing.
    uses ? h("ul", { class: "verdicts", id: "uses" }, uses.rows.map((cells, k) => useLine(found.uses[k], cells, goOn(found.uses[k].next_action, model, signal), words))) : null,
    h("div", { id: "drift" }, foldedTable(drift), found.drift && !found.stop ? driftFigure(found.drift) : null),
    found.common.length ? h("ul", { class: "note" }, found.common.map((one) => h("li", {}, one.detail))) : null,
    found.next_steps.length ? h("details", { id: "next-steps" }, h("summary", {}, "What to do about the error"), h("ol", {}, found.next_steps.map((one) => h("li", {}, one)))) : null,
  ];
}

const LOOKS = { ok: "pass", warning: "not_evaluated", error: "fail" };

/** The tab, or the page, on which each next step is done; another estimator is tried at once. */
const PLACES = { diagnose: "missing", check_gains: "trust", weigh_load: "trust" };
const PAGES = { design: "design", identify_gains: "new" };
const ESTIMATORS = { identify_feasible: "feasible" };
const DO_IT = "Do it here";

function goOn(action, model, signal) {
  if (PLACES[action]) return button(() => goToTab(PLACES[action]));
  if (PAGES[action]) return h("a", { href: address({ view: PAGES[action], robot: model.robot.id }) }, DO_IT);
  const { estimator } = model.identification.request;
  if (!ESTIMATORS[action] || ESTIMATORS[action] === (estimator.name ?? estimator)) return null;
  const said = h("div");
  const again = button(() => pressed(again, () => identifyBy(model, ESTIMATORS[action], said, signal), (error) => put(said, problemBox(error)), signal));
  return [again, said];
}

function button(onclick) {
  return h("button", { type: "button", class: "small", onclick }, DO_IT);
}

function useLine({ use }, [name, fit, reason, next], goingOn, words) {
  const chip = h("span", { class: `chip verdict ${LOOKS[fit.mark]}` }, fit.text);
  return h("li", { "data-use": use }, h("div", { class: "verdict-head" }, h("strong", {}, name.text), chip),
    h("div", { class: "reason" }, h("p", {}, words(reason.text)), h("div", { class: "note" }, `Next: ${next.text} `, goingOn)));
}

/** A gross fault lies in the data; else what is missing comes before whether the rest is to be trusted. */
function nextClick(model, found) {
  const diagnosis = model.diagnosis?.result;
  const [tab, words] = found.stop ? ["data", "Look at the data"] : !diagnosis ? ["missing", "Find what is missing"]
    : diagnosis.verdict === "adequate" ? ["trust", "Validate the model"]
    : ["missing", diagnosis.verdict === "cannot_tell" ? "See what these data cannot tell" : "See what is missing"];
  const open = (name) => {
    model.wantsDiagnosis = name === "missing" && !diagnosis;
    goToTab(name);
    model.dispatchEvent(new Event("wanted"));
  };
  return [h("span", { class: "note" }, "Next:"), h("button", { type: "button", class: "main", id: "next-click", onclick: () => open(tab) }, words)];
}

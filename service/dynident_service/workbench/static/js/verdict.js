// What a model is fit for, in a sentence, and the next thing to do about it.

import { get } from "./api.js";
import { h, put, section } from "./dom.js";
import { orSay } from "./problem.js";
import { goToTab } from "./tabs.js";

/** Asks the service for its verdict; the next click follows the diagnosis. */
export function verdictSection(model, signal) {
  const body = h("div", { id: "fitness" }, h("p", { class: "note" }, "Judging the model …"));
  const next = h("p", { class: "actions" });
  let found = null;
  const showNext = () => put(next, found && nextClick(model, found));
  const judge = () => orSay(body, async () => {
    found = await get(`/identifications/${model.id}/verdict`, {}, signal);
    put(body, judged(found));
    showNext();
  }, signal, judge);
  model.addEventListener("diagnosis", showNext);
  judge();
  return section("fitness", "What it is fit for", body, next);
}

function judged(found) {
  const fit = !found.stop && found.uses.every((one) => one.fit);
  return [
    h("div", { class: fit ? "box good" : "box warning", id: "fitness-summary" }, h("p", {}, found.summary)),
    h("ul", { class: "verdicts", id: "uses" }, found.uses.map(useLine)),
    found.common.length ? h("ul", { class: "note" }, found.common.map((one) => h("li", {}, one.detail))) : null,
    found.next_steps.length ? h("details", { id: "next-steps" }, h("summary", {}, "What to do about the error"), h("ol", {}, found.next_steps.map((one) => h("li", {}, one)))) : null,
  ];
}

function useLine({ use, fit, reason }) {
  const chip = h("span", { class: fit ? "chip verdict pass" : "chip verdict fail" }, fit ? "✓ fit" : "✕ not fit");
  return h("li", { "data-use": use }, h("div", { class: "verdict-head" }, h("strong", {}, use.replaceAll("_", " ")), chip), h("div", { class: "reason" }, h("p", {}, reason)));
}

/** A gross mistake lies in the data; else what is missing comes before whether the rest is to be trusted. */
function nextClick(model, found) {
  const diagnosis = model.diagnosis?.result;
  const [tab, words] = found.stop ? ["data", "Look at the data"] : !diagnosis ? ["missing", "Find what is missing"]
    : diagnosis.verdict === "adequate" ? ["trust", "Validate the model"] : ["missing", "See what is missing"];
  return [h("span", { class: "note" }, "Next:"), h("button", { type: "button", class: "main", id: "next-click", onclick: () => goToTab(tab) }, words)];
}

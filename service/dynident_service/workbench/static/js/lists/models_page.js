// All identified models in one table; two that are ticked are compared.

import { get } from "../api.js";
import { catalogue, titleOf } from "../catalogue.js";
import { h, put } from "../dom.js";
import { moment, percent } from "../format.js";
import { onJobs } from "../jobs.js";
import { address, go, remember } from "../location.js";
import { problemBox } from "../problem.js";
import { archivedBox, labelsButton, tagChips } from "./labels.js";
import { pairSection } from "./pair.js";
import { readAll, robotNames } from "./reading.js";
import { sortable } from "./sortable.js";

const MODEL_JOBS = new Set(["identification", "extension", "removal"]);
const verdicts = new Map(); // model's id -> what was said of it; a model never changes

/** The table of models, or with `pair` two of them side by side. */
export async function page(target, wanted, signal) {
  document.title = "Models: dynident";
  if (wanted.pair) return pairSection(target, wanted.pair.split(","), signal);
  const [effects, robots] = await Promise.all([catalogue(), robotNames(signal)]);
  const ticked = new Set();
  const state = { archived: wanted.archived === "yes", models: [], judging: null };
  const said = h("div");
  const compare = h("button", { type: "button", class: "main", id: "compare-two", disabled: true, onclick: () => go({ view: "models", pair: [...ticked].join(",") }) }, "Compare the two");
  const hint = h("span", { class: "note", role: "status" }, "Tick two models to see how they differ.");

  const tick = (model, box) => {
    if (box.checked) ticked.add(model.id);
    else ticked.delete(model.id);
    compare.disabled = ticked.size !== 2;
    hint.textContent = ["Tick two models to see how they differ.", "One more.", "", "Two at a time: untick the others."][Math.min(ticked.size, 3)];
  };
  const changed = (before) => (after) => {
    state.models = state.models.map((one) => (one.id === before.id ? after : one)).filter((one) => one && (state.archived || !one.archived));
    ticked.delete(before.id);
    list.update(state.models);
    dispatchEvent(new Event("models-changed"));
  };
  const columns = [
    { id: "tick", name: "two", control: true, cell: (one) => h("input", { type: "checkbox", "aria-label": `Compare ${nameOf(one, robots)}`, checked: ticked.has(one.id), disabled: !one.result, onchange: (event) => tick(one, event.target) }) },
    { id: "name", name: "name", value: (one) => nameOf(one, robots), cell: (one) => h("a", { href: address({ identification: one.id }) }, nameOf(one, robots)) },
    { id: "robot", name: "robot", value: (one) => robots.get(one.robot_id) ?? "", cell: (one) => robots.get(one.robot_id) ?? "" },
    { id: "date", name: "date", value: (one) => one.created_at, text: (one) => moment(one.created_at), cell: (one) => h("time", { datetime: one.created_at }, moment(one.created_at)) },
    { id: "effects", name: "effects", value: (one) => effectsOf(one, effects), cell: (one) => effectsOf(one, effects) },
    { id: "error", name: "held-out error", right: true, value: (one) => one.result?.validation?.relative_total ?? null, text: () => "", cell: (one) => errorOf(one) },
    { id: "fit", name: "error of the fit", right: true, value: (one) => one.result?.residual.relative_total ?? null, text: () => "", cell: (one) => percent(one.result?.residual.relative_total) },
    { id: "tags", name: "tags", value: (one) => one.tags.join(" "), cell: (one) => tagChips(one) },
    { id: "verdict", name: "verdict", value: (one) => verdicts.get(one.id)?.words ?? "", cell: (one) => verdictOf(one) },
    { id: "change", name: "", cell: (one) => labelsButton(`/identifications/${one.id}`, one, changed(one)) },
  ];
  const list = sortable({ caption: "Identified models", noun: "model", columns, usual: "-date", id: "models-table", empty: "No model yet: a new one begins with a robot and its recordings.", rowOf: (one) => ({ "data-id": one.id }) });

  function verdictOf(model) {
    if (!model.result) return h("span", { class: `mark ${model.status}` }, model.status);
    const known = verdicts.get(model.id);
    if (known) return h("span", { title: known.summary }, known.words);
    return h("button", { type: "button", class: "small", "aria-label": `Judge ${nameOf(model, robots)}`, onclick: (event) => judge(model, event.target) }, "Judge");
  }

  async function judge(model, button) {
    button.disabled = true;
    button.textContent = "judging …";
    try {
      const found = await get(`/identifications/${model.id}/verdict`, {}, signal);
      verdicts.set(model.id, { words: verdictInWords(found), summary: found.summary });
      list.show();
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error));
      button.disabled = false;
      button.textContent = "Judge";
    }
  }

  const read = async () => {
    try {
      await readAll("/identifications", { archived: state.archived || null }, (items) => {
        state.models = [...items];
        list.update(state.models);
      }, signal);
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error, read));
    }
  };
  const withArchived = (all) => {
    state.archived = all;
    remember({ archived: all ? "yes" : "" });
    read();
  };
  onJobs((job) => MODEL_JOBS.has(job.kind) && job.state === "succeeded" && read(), signal);
  put(
    target,
    h("h1", {}, "Models"),
    h("p", { class: "actions" }, compare, hint, h("a", { class: "button", href: address({ view: "new" }) }, "New model"), archivedBox(state.archived, withArchived)),
    said,
    list.element,
  );
  await read();
}

function nameOf(model, robots) {
  return model.name || robots.get(model.robot_id) || model.id;
}

function effectsOf(model, effects) {
  return [...new Set((model.result?.effects ?? model.request.effects).map((one) => titleOf(effects, one.effect)))].join(", ");
}

function errorOf({ result }) {
  if (!result) return "–";
  return result.validation ? h("data", { value: result.validation.relative_total }, percent(result.validation.relative_total)) : "no data held out";
}

function verdictInWords(found) {
  if (found.stop) return `not to be used: ${found.stop.cause}`;
  const fit = found.uses.filter((one) => one.fit).map((one) => one.use.replaceAll("_", " "));
  return fit.length ? `fit for ${fit.join(", ")}` : "fit for none of the uses";
}

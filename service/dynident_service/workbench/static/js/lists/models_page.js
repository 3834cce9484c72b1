// Page of all identified models; two that are ticked are compared.

import { get } from "../api.js";
import { catalogue, choiceInWords, titleOf } from "../catalogue.js";
import { h } from "../dom.js";
import { judged } from "../joint_errors.js";
import { percent, quantity } from "../format.js";
import { MODEL_JOBS } from "../jobs.js";
import { address, go } from "../page_address.js";
import { dateColumn, figureColumn, labelColumns, plainColumn } from "./common_columns.js";
import { pairSection } from "./model_pair.js";
import { robotNames } from "./paged_lists.js";
import { fieldsOf } from "../schema.js";
import { resourcesPage } from "./resource_page.js";

let usual = new Set(); // effects that an identification has by itself
const verdicts = new Map(); // model's id -> what was said of it when it was asked for

/** The table of models, or with `pair` two of them side by side. */
export async function page(target, wanted, signal) {
  document.title = "Models: dynident";
  if (wanted.pair) return pairSection(target, wanted.pair.split(","), signal);
  const [effects, robots, asked] = await Promise.all([catalogue(), robotNames(signal), fieldsOf("IdentificationRequest")]);
  usual = new Set(asked.effects.default.map((one) => one.effect));
  const ticked = new Set();
  const compare = h("button", { type: "button", class: "main", id: "compare-two", disabled: true, onclick: () => go({ view: "models", pair: [...ticked].join(",") }) }, "Compare the two");
  const hint = h("span", { class: "note", role: "status" }, "Tick two models to see how they differ.");

  const tick = (model, box) => {
    if (box.checked) ticked.add(model.id);
    else ticked.delete(model.id);
    compare.disabled = ticked.size !== 2;
    hint.textContent = ["Tick two models to see how they differ.", "Tick one more.", "", "Only two at a time: untick the others."][Math.min(ticked.size, 3)];
  };
  const onChanged = (before) => {
    ticked.delete(before.id);
    dispatchEvent(new Event("models-changed"));
  };
  const columns = (changed, table) => {
    const [tags, change] = labelColumns("/identifications", changed);
    return [
      { id: "tick", name: "two", control: true, cell: (one) => h("input", { type: "checkbox", "aria-label": `Compare ${nameOf(one, robots)}`, checked: ticked.has(one.id), disabled: !one.result, onchange: (event) => tick(one, event.target) }) },
      { id: "name", name: "name", value: (one) => nameOf(one, robots), cell: (one) => h("a", { href: address({ identification: one.id }) }, nameOf(one, robots)) },
      { ...plainColumn("robot", "robot", (one) => robots.get(one.robot_id) ?? ""), folded: robots.size < 2 },
      dateColumn(),
      plainColumn("effects", "effects besides the default ones", (one) => effectsOf(one, effects)),
      plainColumn("recordings", "recordings", (one) => recordingsOf(one, "identification", "measurement_ids")),
      { ...plainColumn("held-out", "held out", (one) => recordingsOf(one, "validation", "validation_ids")), folded: true },
      plainColumn("estimator", "estimator", (one) => wordOf(one.request.estimator)),
      { ...plainColumn("model", "equation", (one) => wordOf(one.request.model)), folded: true },
      { ...plainColumn("filters", "filters", filtersOf), folded: true },
      { id: "error", name: "held-out error", right: true, value: (one) => (one.result?.validation ? judged(one.result.validation).relative_total : null), text: () => "", cell: (one) => errorOf(one) },
      figureColumn("fit", "error of the fit", (one) => (one.result ? judged(one.result.residual).relative_total : null), percent),
      tags,
      { id: "verdict", name: "verdict", value: (one) => verdicts.get(one.id) ?? "", cell: (one) => verdictOf(one, table) },
      change,
    ];
  };

  function verdictOf(model, table) {
    if (!model.result) return h("span", { class: `mark ${model.status}` }, model.status);
    if (verdicts.has(model.id)) return verdicts.get(model.id);
    return h("button", { type: "button", class: "small", "aria-label": `Judge ${nameOf(model, robots)}`, onclick: (event) => judge(model, event.target, table) }, "Judge");
  }

  async function judge(model, button, table) {
    button.disabled = true;
    button.textContent = "judging …";
    try {
      const found = await get(`/identifications/${model.id}/verdict`, {}, signal);
      verdicts.set(model.id, found.summary);
      table.show();
    } catch (error) {
      if (!signal.aborted) table.fail(error);
      button.disabled = false;
      button.textContent = "Judge";
    }
  }

  const empty = "No model yet: a new one begins with a robot and its recordings.";
  await resourcesPage(target, { title: "Models", caption: "Identified models", path: "/identifications", query: { brief: true }, noun: "model", columns, id: "models-table", empty, acts: [compare, hint], onChanged, madeBy: MODEL_JOBS }, wanted, signal);
}

function nameOf(model, robots) {
  return model.name || robots.get(model.robot_id) || model.id;
}

/** The effects that an identification does not have by itself, each with its joints. */
function effectsOf(model, effects) {
  const all = model.result?.effects ?? model.request.effects;
  const joints = model.result?.joints ?? [];
  const own = all.filter((one) => !usual.has(one.effect) || (one.joints.length && one.joints.length < joints.length));
  const left = [...usual].filter((id) => !all.some((one) => one.effect === id)).map((id) => `without ${titleOf(effects, id)}`);
  return [...own.map((one) => choiceInWords(effects, one, joints)), ...left].join(", ") || "none";
}

function recordingsOf({ result, request }, role, ids) {
  const names = (result?.measurements ?? []).filter((one) => one.role === role).map((one) => one.name ?? one.id);
  return (names.length ? names : request[ids]).join(", ") || "none";
}

function wordOf(choice) {
  return (choice?.name ?? choice ?? "").replaceAll("_", " ");
}

function filtersOf({ result }) {
  if (!result) return "";
  const { position_cutoff: q, torque_cutoff: tau, decimation } = result.preprocessing;
  const words = (value) => (value === null ? "none" : quantity(value, "Hz"));
  return `position ${words(q)}, torque ${words(tau)}, decimation ${decimation}`;
}

function errorOf({ result }) {
  if (!result) return "–";
  if (!result.validation) return "no data held out";
  const { relative_total: total } = judged(result.validation);
  return h("data", { value: total }, percent(total));
}

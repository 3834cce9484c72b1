// Page of one identified model: its sections in tabs.

import { content, get, post, apiKey } from "./api.js";
import { choiceInWords, placeOf, titleOf } from "./catalogue.js";
import { announce, h, put, tiles } from "./dom.js";
import { dataSection } from "./data_of_model.js";
import { daysSection } from "./changes_over_days.js";
import { errorsSection } from "./joint_errors.js";
import { failureSection } from "./where_model_fails.js";
import { counted, moment, number, quantity } from "./format.js";
import { awaited, ENDED, newestOf } from "./jobs.js";
import { ladderSection } from "./ladder.js";
import { limbTree } from "./limbs.js";
import { takeNote } from "./page_address.js";
import { methodInWords, methods } from "./methods.js";
import { missingSection } from "./missing_effects.js";
import { Model, newestDiagnosis } from "./shown_model.js";
import { parametersSection } from "./parameters.js";
import { orSay, pressed, problemBox } from "./problem.js";
import { exportLinks, save } from "./save_file.js";
import { spectraSection } from "./spectra.js";
import { tabs } from "./tabs.js";
import { torqueSection } from "./torque_comparison.js";
import { newestValidations, validationsSection } from "./validations.js";
import { verdictSection } from "./verdict.js";

/** Show an identification; while it is being computed, how far it is. */
export async function modelPage(target, wanted, signal) {
  let identification = await get(`/identifications/${wanted.identification}`, {}, signal);
  if (!ENDED.has(identification.status)) identification = await wait(target, identification, signal);
  if (identification.status !== "succeeded") return put(target, ended(identification));
  const [model, ways] = await Promise.all([Model.of(identification, wanted, signal), methods()]);
  signal.throwIfAborted();
  document.title = `${nameOf(model)}: dynident`;
  put(target, header(model, ways, signal), limbTree(model.robot, (joints) => model.chooseLimb(joints), signal), tabs("Parts of the model", parts(model, ways, signal), tabOf, signal));
  if (takeNote()?.arrived) {
    dispatchEvent(new Event("models-changed"));
    const ladder = document.getElementById("ladder-title");
    ladder?.scrollIntoView({ block: "start" });
    ladder?.focus({ preventScroll: true });
    announce(model.lastStep?.text ?? "");
  }
  model.setDiagnosis(await newestDiagnosis(model, signal));
  await idle();
  model.compareAhead(signal).catch(() => {}); // Asked for again, and complained of, when its tab is opened.
}

/** Until there is nothing to draw. */
function idle() {
  return new Promise((resolve) => (globalThis.requestIdleCallback ? requestIdleCallback(resolve, { timeout: 1000 }) : setTimeout(resolve, 50)));
}

/** What is made of the model when its tab is opened. */
function parts(model, ways, signal) {
  return [
    { id: "verdict", title: "Verdict", sections: () => [verdictSection(model, signal), figures(model, signal), warnings(model.result), errorsSection(model, signal)] },
    { id: "compare", title: "Compare", sections: () => [torqueSection(model, signal), failureSection(model, signal), spectraSection(model, signal)] },
    { id: "missing", title: "Missing", sections: () => [ladderSection(model, signal), missingSection(model, signal)] },
    { id: "parameters", title: "Parameters", sections: () => [parametersSection(model, signal)] },
    { id: "trust", title: "Trust", sections: () => [validationsSection(model, ways.validations, signal), daysSection(model, signal)] },
    { id: "data", title: "Data", sections: () => [dataSection(model)] },
  ];
}

/** The tab of an address from before there were tabs: an interval or a measurement was looked at in the comparison. */
function tabOf(wanted) {
  return wanted.from || wanted.measurement ? "compare" : "verdict";
}

async function wait(target, identification, signal) {
  const place = h("div");
  put(target, h("h1", {}, identification.name || "A new model"), place);
  const found = await awaited("/identifications", identification, "Identifying", place, signal).catch((error) => {
    if (error.status === undefined) throw error;
    return get(`/identifications/${identification.id}`, {}, signal);
  });
  announce(`The identification ${found.status}`);
  return found;
}

function ended(identification) {
  const { error, status } = identification;
  const said = error
    ? { title: error.title, message: error.detail, fields: error.errors ?? [] }
    : { title: "No model", message: `The identification was ${status}.` };
  return [h("h1", {}, identification.name || "A model"), problemBox(said)];
}

function nameOf(model) {
  return model.identification.name || model.robot.name;
}

function header(model, ways, signal) {
  const { identification: found, result } = model;
  return h("section", { "aria-label": "Model" },
    h("h1", {}, nameOf(model)),
    h("p", { class: "note" }, `${model.robot.name}, ${counted(model.joints.length, "joint")}; ${moment(found.created_at)}; `,
      `${methodInWords(ways, found.request)}; ${filters(result.preprocessing)}`),
    h("p", { class: "chips" }, h("span", {}, "In the model:"), result.effects.map((one) => h("span", { class: "chip", title: choiceInWords(model.effects, one, model.joints) }, titleOf(model.effects, one.effect),
      one.joints.length && one.joints.length < model.joints.length ? h("small", {}, ` ${placeOf(model.effects, one)}`) : null))),
    actions(model, ways, signal),
  );
}

/** The main figures of the model. */
function figures(model, signal) {
  const body = h("div");
  const read = () => orSay(body, async () => {
    const [{ rows }] = await model.tables(["quality"], signal);
    const ids = ["tile-held_out", "tile-fit"];
    put(body, tiles(rows.map(([name, value, meaning], k) => [name.text, value.text, meaning.text, ids[k]])));
  }, signal, read);
  read();
  return body;
}

function filters(used) {
  const cutoff = (value) => (value === null ? "none" : quantity(value, "Hz"));
  return `filters: position ${cutoff(used.position_cutoff)}, torque ${cutoff(used.torque_cutoff)}, decimation ${used.decimation}`;
}

function warnings(result) {
  const all = result.warnings;
  if (!all.length) return null;
  return h("div", { class: "box warning", id: "warnings" }, h("p", {}, h("strong", {}, "Before you use this model")), h("ul", {}, all.map((one) => h("li", {}, one))));
}

function actions(model, ways, signal) {
  const said = h("div");
  const written = h("div", { id: "reports" });
  const reports = [["html", "Report"], ["pdf", "Report as PDF"]].map(([format, words]) => h("button", { type: "button", onclick: (event) => makeReport(model, format, ways, event.target, written, signal) }, words));
  showLastReport(model, written, signal);
  // Folded: the formats would push the verdict down.
  const exports = h("details", { id: "exports" }, h("summary", {}, "Export the model"), h("p", { class: "actions" }, exportLinks(model, ways.exports, said)));
  return [h("p", { class: "actions" }, reports), written, exports, said];
}

/** Show the newest report, also one that is still being written. */
function showLastReport(model, place, signal) {
  return orSay(place, async () => {
    const last = await newestOf("/reports", { identification_id: model.id }, signal, (one) => one.request.format !== "json");
    // A report that was asked for meanwhile is newer.
    if (last && !place.firstChild) await showReport(last, place, signal);
  }, signal);
}

async function makeReport(model, format, ways, button, place, signal) {
  await pressed(button, async () => {
    const diagnosis = model.diagnosis?.status === "succeeded" ? model.diagnosis.id : null;
    const validations = await newestValidations(model, ways.validations);
    const made = await post("/reports", { identification_id: model.id, diagnosis_id: diagnosis, validation_ids: validations, format, name: nameOf(model) });
    await showReport(made, place, signal);
    announce("The report is written");
  }, (error) => signal.aborted || put(place, problemBox(error)));
}

async function showReport(report, place, signal) {
  const { id, result, request, created_at } = await awaited("/reports", report, "Writing the report", place, signal);
  const open = apiKey.get()
    ? h("button", { type: "button", onclick: async () => save(await content(result.href), `${id}.${request.format}`) }, "Save the report")
    : h("a", { href: result.href, target: "_blank", rel: "noopener" }, "Open the report");
  put(place, h("p", {}, open, ` of ${moment(created_at)} (${number(result.size / 1e6, 2)} MB, one ${request.format === "pdf" ? "PDF" : "HTML file"})`));
}

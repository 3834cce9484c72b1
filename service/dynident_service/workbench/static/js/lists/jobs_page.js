// Page of all jobs: state, message, button that cancels.

import { apiKey, events, get } from "../api.js";
import { h, put } from "../dom.js";
import { moment, number, percent } from "../format.js";
import { cancel, ENDED, onJobs } from "../jobs.js";
import { address } from "../page_address.js";
import { orSay, problemBox } from "../problem.js";
import { dateColumn, figureColumn, plainColumn } from "./common_columns.js";
import { readAll } from "./paged_lists.js";
import { sortable } from "./sortable_table.js";

const LOOK_AGAIN = 2000;

export async function page(target, wanted, signal) {
  if (wanted.resource) return openResult(wanted.resource, signal);
  document.title = "Jobs: dynident";
  const said = h("div");
  const columns = [
    { id: "kind", name: "job", value: (one) => one.kind, cell: (one) => of(one) },
    { id: "state", name: "state", value: (one) => one.state, cell: (one) => h("span", { class: `mark ${one.state}` }, one.state) },
    { id: "progress", name: "progress", value: (one) => one.progress.fraction, text: () => "", cell: (one) => progress(one) },
    plainColumn("message", "last message", wordsOf),
    dateColumn("requested"),
    figureColumn("took", "duration", seconds, (value) => (value === null ? "–" : `${number(value, 2)} s`)),
    { id: "acts", name: "", cell: (one) => [h("button", { type: "button", class: "small", "aria-label": `Log of ${one.kind} ${one.id}`, onclick: (event) => log(one, event.target) }, "Log"), " ", ENDED.has(one.state) ? null : h("button", { type: "button", class: "small", "aria-label": `Cancel ${one.kind} ${one.id}`, onclick: (event) => stop(one, event.target) }, "Cancel")] },
  ];
  const list = sortable({ caption: "Jobs", noun: "job", columns, usual: "-date", id: "jobs-table", empty: "No job yet: identifications, diagnoses, designs and reports are listed here when they are requested.", rowOf: (one) => ({ "data-id": one.id }) });
  const place = h("div", { id: "job-log" });

  async function stop(job, button) {
    button.disabled = true;
    button.textContent = "stopping";
    try {
      await cancel(job.id);
      await read();
    } catch (error) {
      put(said, problemBox(error));
      button.disabled = false;
    }
  }

  async function log(job) {
    const lines = h("ol", {});
    put(place, h("h2", { tabindex: "-1" }, `Log of ${job.kind.replaceAll("_", " ")}, ${moment(job.created_at)}`), job.error ? problemBox({ title: job.error.title, message: job.error.detail, fields: job.error.errors }) : null, lines);
    place.firstChild.focus();
    await orSay(said, async () => {
      for await (const event of events(job.id, signal)) {
        if (!lines.isConnected) return;
        lines.append(h("li", {}, event.kind === "state" ? h("strong", {}, event.state) : `${percent(event.fraction, 2)} ${event.message}`));
      }
    }, signal);
  }

  let reading = null;
  const read = () => {
    reading ??= orSay(said, () => readAll("/jobs", {}, (items) => list.update([...items]), signal), signal, read).finally(() => { reading = null; });
    return reading;
  };
  // A table that is drawn anew takes the focus away: not under somebody's hand.
  const held = () => document.hidden || list.element.querySelector("tbody :focus");
  let waiting = null;
  const again = async () => {
    waiting = null;
    const isHeld = held();
    const jobs = isHeld ? [] : ((await read()) ?? []);
    if (signal.aborted || waiting) return;
    if (isHeld || jobs.some((one) => !ENDED.has(one.state))) waiting = setTimeout(again, LOOK_AGAIN);
  };
  onJobs(() => {
    clearTimeout(waiting);
    again();
  }, signal);
  signal.addEventListener("abort", () => clearTimeout(waiting));
  put(target, h("h1", {}, "Jobs"), said, list.element, place);
  await again();
}

function of(job) {
  const words = job.kind.replaceAll("_", " ");
  if (!job.resource) return words;
  const { kind, id } = job.resource;
  // A link cannot carry a key: with one, the report is opened from the model's page.
  if (kind === "report" && job.state === "succeeded" && !apiKey.get()) return h("a", { href: `/v1/reports/${id}/content`, target: "_blank", rel: "noopener" }, words);
  return h("a", { href: address(ADDRESSES[kind]?.(id) ?? { view: "jobs", resource: job.resource.href.replace("/v1/", "") }) }, words);
}

/** Where a result is shown, as far as its identifier tells. */
const ADDRESSES = {
  identification: (identification) => ({ identification }),
  design: (design) => ({ view: "design", design }),
  measurement: (measurement) => ({ view: "recording", measurement }),
};

/** Where a result is shown whose resource says what it is of. */
const ADDRESSES_BY_REQUEST = {
  diagnoses: ({ request: { baseline_ids: before, identification_id: identification } }) => (before.length ? { view: "changes", identification } : { identification, tab: "missing" }),
  next_experiments: async ({ request }, signal) => ADDRESSES_BY_REQUEST.diagnoses(await get(`/diagnoses/${request.diagnosis_id}`, {}, signal)),
  comparisons: ({ request }) => ({ identification: request.identification_id, tab: "compare", measurement: request.measurement_id }),
  validations: ({ request }) => ({ identification: request.identification_id, tab: "trust" }),
  series: ({ request }) => ({ identification: request.identification_id, tab: "trust" }),
  simulations: ({ request, result }) => (result ? { view: "recording", measurement: result.measurement_id } : { view: "new", robot: request.robot_id }),
  drive_gains: ({ request }) => ({ view: "new", robot: request.robot_id }),
  current_models: ({ request }) => ({ view: "new", robot: request.robot_id }),
  reports: ({ request }) => ({ identification: request.identification_id }),
};

/** Go on to the page that shows a result: `path` is that of its resource. */
async function openResult(path, signal) {
  const [kind] = path.split("/");
  const wanted = await ADDRESSES_BY_REQUEST[kind]?.(await get(`/${path}`, {}, signal), signal);
  // Back leads to the list, and not here.
  history.replaceState(null, "", address(wanted ?? { view: "jobs" }));
  dispatchEvent(new PopStateEvent("popstate"));
}

function progress(job) {
  return h("progress", { max: 1, value: job.state === "succeeded" ? 1 : job.progress.fraction, "aria-label": `Progress of ${job.kind}` });
}

function wordsOf(job) {
  return job.error ? `${job.error.title}: ${job.error.detail}` : job.progress.message;
}

function seconds(job) {
  return job.started_at && job.finished_at ? (new Date(job.finished_at) - new Date(job.started_at)) / 1000 : null;
}

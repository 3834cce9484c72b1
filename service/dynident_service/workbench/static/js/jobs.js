// Waiting for jobs: progress from their events, cancel buttons, the newest job of a kind.

import { events, get, post, ProblemError } from "./api.js";
import { h, put } from "./dom.js";
import { percent } from "./format.js";

/** Kinds of jobs that make models. */
export const MODEL_JOBS = new Set(["identification", "extension", "removal"]);

/** States that a job, and what it makes, stay in. */
export const ENDED = new Set(["succeeded", "failed", "cancelled"]);
const MOST_STREAMS = 3; // A browser opens six connections to a service; some are needed for the rest.
const LOOK_AGAIN = 4000;
const LATEST = 50;
const live = new Map(); // id -> { id, kind, resource, state, fraction, message }
const listeners = new Set();
let streams = 0;
let newest; // The newest job known; undefined before the first look.

/** Follow a job until it ends; `onChange({ state, fraction, message })` at every step. Gives the last of them. */
export async function follow(jobId, onChange = () => {}, signal = undefined) {
  const seen = { state: "queued", fraction: 0, message: "" };
  while (!ENDED.has(seen.state)) {
    if (signal?.aborted) return seen;
    if (streams >= MOST_STREAMS) {
      const job = await get(`/jobs/${jobId}`, {}, signal);
      onChange(Object.assign(seen, { state: job.state, ...job.progress }));
      if (!ENDED.has(seen.state)) await new Promise((resolve) => setTimeout(resolve, 500));
      continue;
    }
    streams += 1;
    try {
      for await (const event of events(jobId, signal)) {
        if (event.kind === "state") seen.state = event.state;
        else Object.assign(seen, { fraction: event.fraction, message: event.message });
        onChange(seen);
      }
    } finally {
      streams -= 1;
    }
  }
  return seen;
}

/** Wait for a resource that a job computes; give it with its result. A job that failed is thrown as its problem. */
export async function computed(path, resource, onChange = () => {}, signal = undefined) {
  if (!ENDED.has(resource.status)) await follow(resource.job_id, onChange, signal);
  signal?.throwIfAborted();
  const found = await get(`${path}/${resource.id}`, {}, signal);
  if (found.status === "succeeded") return found;
  if (found.error) throw new ProblemError(found.error);
  throw new ProblemError({ title: "Cancelled", detail: "The job was cancelled before it ended." });
}

/** The same, while `place` shows how far it is; it is empty afterwards. `onChange` is told, too. */
export async function awaited(path, resource, label, place, signal = undefined, onChange = () => {}) {
  const bar = progressBar(resource.job_id, label);
  if (!ENDED.has(resource.status)) put(place, bar.element);
  const seen = (state) => {
    bar.update(state);
    onChange(state);
  };
  return computed(path, resource, seen, signal).finally(() => put(place));
}

/** The newest of a list that is done or on its way, of those that fit; undefined where there is none. */
export async function newestOf(path, query, signal = undefined, fits = () => true) {
  const { items } = await get(path, { limit: 20, ...query }, signal);
  return items.find((one) => !["failed", "cancelled"].includes(one.status) && fits(one));
}

/** Stop a job. */
export function cancel(jobId) {
  return post(`/jobs/${jobId}/cancel`, {});
}

/** A bar that shows how far a job is, with a button that stops it. */
function progressBar(jobId, label) {
  const bar = h("progress", { max: 1, value: 0, "aria-label": label });
  const words = h("span", { class: "note" }, "waiting");
  const stop = h("button", { type: "button", class: "small", onclick: () => halt() }, "Cancel");
  async function halt() {
    stop.disabled = true;
    words.textContent = "stopping";
    await cancel(jobId).catch((error) => {
      words.textContent = error.message;
      stop.disabled = false;
    });
  }
  const element = h("div", { class: "progress" }, h("span", {}, label), bar, words, stop);
  const update = ({ state, fraction, message }) => {
    bar.value = fraction;
    words.textContent = state === "queued" ? "queued" : `${percent(fraction, 2)} ${message}`;
  };
  return { element, update };
}

/** What is sent and answered at once, with a button that gives it up, shown in `place`: { signal, stop, bar, how }. */
export function givenUp(words, place) {
  const given = new AbortController();
  const bar = h("progress", { max: 1, "aria-label": words });
  const how = h("span", { class: "note" });
  const stop = () => given.abort();
  put(place, h("div", { class: "progress" }, h("span", {}, words), bar, how, h("button", { type: "button", class: "small", onclick: stop }, "Cancel")));
  return { signal: given.signal, stop, bar, how };
}

/** Tell a listener whenever a job began, moved or ended, whoever asked for it; until `signal` aborts. */
export function onJobs(listener, signal = undefined) {
  listeners.add(listener);
  signal?.addEventListener("abort", () => listeners.delete(listener));
}

/** Look for running jobs now and from time to time, and show them in `target`. */
export function watch(target) {
  onJobs(() => put(target, [...live.values()].map((one) => one.bar.element)));
  const look = async () => {
    if (!document.hidden) await lookForJobs().catch(() => {});
    setTimeout(look, LOOK_AGAIN);
  };
  look();
}

/** Look for jobs that run and follow those that are new; tell of one that came and went unseen. */
export async function lookForJobs() {
  const { items } = await get("/jobs", { limit: LATEST });
  for (const job of items) if (!ENDED.has(job.state) && !live.has(job.id)) track(job);
  const before = newest;
  newest = items[0]?.id ?? null;
  if (before !== undefined && newest !== before && ENDED.has(items[0]?.state)) tell(items[0]);
}

async function track(job) {
  const bar = progressBar(job.id, job.kind.replaceAll("_", " "));
  const entry = { id: job.id, kind: job.kind, resource: job.resource, state: job.state, bar };
  live.set(job.id, entry);
  bar.update({ state: job.state, ...job.progress });
  tell(entry);
  try {
    await follow(job.id, (seen) => {
      bar.update(seen);
      const changed = entry.state !== seen.state;
      entry.state = seen.state;
      if (changed) tell(entry);
    });
  } finally {
    live.delete(job.id);
    tell(entry);
  }
}

function tell(entry) {
  for (const listener of listeners) listener(entry);
}

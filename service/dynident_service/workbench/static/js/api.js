// Calls of the HTTP API: errors as problems (RFC 9457), retries, files, events of jobs.

const KEY = "dynident.key";
const RETRY = 1000;
const PATIENCE = 30000; // ms for which a service that is away, as while it is restarted, is asked again
const SOON = 5000; // ms for which an answer that was asked for ahead is a new one
const early = new Map(); // path -> { answer, at }
let waiting = 0; // questions that are asked again

/** An answer that says what is wrong. */
export class ProblemError extends Error {
  constructor(problem) {
    super(problem.detail ?? problem.title);
    this.status = problem.status ?? 0;
    this.title = problem.title ?? "Problem";
    this.fields = problem.errors ?? [];
    this.dependents = problem.dependents ?? [];
    this.checks = problem.checks ?? [];
  }
}

export const apiKey = {
  get: () => sessionStorage.getItem(KEY) ?? "",
  set: (key) => sessionStorage.setItem(KEY, key),
};

/** Get a resource: get("/identifications", { limit: 20 }). */
export async function get(path, query = {}, signal = undefined) {
  const address = path + search(query);
  const { answer, at } = early.get(address) ?? {};
  early.delete(address);
  const found = at > performance.now() - SOON ? await answer : null;
  signal?.throwIfAborted();
  return found ?? ask("GET", address, { signal });
}

/** Ask now for what will be wanted in a moment: the next to get it is given this answer, and it alone. */
export function ahead(path, answer = ask("GET", path)) {
  // Who gets it asks anew, and hears what is wrong.
  early.set(path, { answer: answer.catch(() => null), at: performance.now() });
}

/** What is read once and kept; what could not be read is asked for again. */
export function once(read) {
  let reading = null;
  return () => {
    reading ??= read().catch((error) => {
      reading = null;
      throw error;
    });
    return reading;
  };
}

/** A JSON document by its whole address. */
export async function whole(path) {
  return (await send("GET", path, {})).json();
}

/** Of several questions only the last is answered: each call ends what it gave before and gives a new signal. */
export function lastAsked(until) {
  let asked = new AbortController();
  until.addEventListener("abort", () => asked.abort());
  return () => {
    asked.abort();
    asked = new AbortController();
    if (until.aborted) asked.abort();
    return asked.signal;
  };
}

/** Post a body; with a key, asking again gives the same resource. */
export function post(path, body, { key = "", signal = undefined } = {}) {
  const headers = { "content-type": "application/json" };
  if (key) headers["idempotency-key"] = key;
  return ask("POST", path, { headers, body: JSON.stringify(body), signal });
}

/** Change a resource: what is not given stays. */
export function patch(path, body) {
  return ask("PATCH", path, { headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
}

/** Delete a resource; 409 with its dependents while others rest on it. */
export function remove(path) {
  return ask("DELETE", path, {});
}

/** Upload a recording; `onProgress` is told the share that has gone. */
export function upload(path, file, metadata, { further = [], onProgress = null, signal = undefined } = {}) {
  const form = new FormData();
  form.append("metadata", JSON.stringify(metadata));
  form.append("file", file, file.name);
  for (const one of further) form.append("further", one, one.name);
  // fetch does not tell how far an upload is.
  const request = new XMLHttpRequest();
  const key = apiKey.get();
  return new Promise((resolve, reject) => {
    request.open("POST", `/v1${path}`);
    for (const [name, value] of Object.entries(credentials())) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => onProgress?.(event.total ? event.loaded / event.total : 0);
    request.onload = () => settle(request.status, request.responseText, key, resolve, reject);
    request.onerror = () => reject(unreachable());
    request.onabort = () => reject(new DOMException("The upload was cancelled.", "AbortError"));
    signal?.addEventListener("abort", () => request.abort());
    request.send(form);
  });
}

/** Give a document that a link cannot open because the link cannot carry the key. */
export async function content(path) {
  const answer = await send("GET", path, {});
  return answer.blob();
}

/** A file to be saved: { content, name, notes }, notes being what its format could not hold. */
export async function file(path) {
  const answer = await send("GET", path, {});
  const name = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition") ?? "")?.[1] ?? "model";
  return { content: await answer.blob(), name, notes: JSON.parse(answer.headers.get("dynident-notes") ?? "[]") };
}

/** The events of a job, from the first until it ends. */
export function events(jobId, signal) {
  return follow(`/jobs/${jobId}/events`, signal);
}

/** The events of a stream; one that broke is taken up where it broke. */
export async function* follow(path, signal) {
  let last = "";
  while (!signal?.aborted) {
    const headers = last ? { "last-event-id": last } : {};
    try {
      const answer = await send("GET", `/v1${path}`, { headers, signal });
      for await (const event of parsed(answer.body)) {
        last = event.id || last;
        if (event.data) yield { kind: event.event, ...JSON.parse(event.data) };
      }
      return;
    } catch (error) {
      if (signal?.aborted || (error instanceof ProblemError && error.status)) throw error;
      await new Promise((resolve) => setTimeout(resolve, RETRY));
    }
  }
}

async function* parsed(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const blocks = (rest + value.replaceAll("\r\n", "\n")).split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const event = { id: "", event: "message", data: "" };
      for (const line of block.split("\n")) {
        const at = line.indexOf(":");
        if (at > 0) event[line.slice(0, at)] = line.slice(at + 1).trimStart();
      }
      yield event;
    }
  }
}

/** Ask for a resource by any method: ask("DELETE", "/measurements/…"); null where there is no answer to read. */
export async function ask(method, path, options = {}) {
  const answer = await send(method, `/v1${path}`, options);
  return answer.status === 204 ? null : answer.json();
}

async function send(method, path, { headers = {}, body = undefined, signal = undefined }) {
  const key = apiKey.get();
  const request = { method, headers: { ...headers, ...credentials() }, body, signal };
  // What may have been done, and would be done twice, is not asked again.
  const again = method === "GET" || "idempotency-key" in headers;
  const answer = await reached(path, request, again ? PATIENCE : 0);
  if (!answer.ok) throw problemFrom(answer.status, await answer.text(), key);
  return answer;
}

async function reached(path, request, patience) {
  try {
    return await fetch(path, request);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    if (!patience) throw unreachable();
  }
  const until = performance.now() + patience;
  tellWaiting(1);
  try {
    while (performance.now() < until) {
      await new Promise((resolve) => setTimeout(resolve, RETRY));
      request.signal?.throwIfAborted();
      const answer = await fetch(path, request).catch((error) => {
        if (error.name === "AbortError") throw error;
      });
      if (answer) return answer;
    }
  } finally {
    tellWaiting(-1);
  }
  throw unreachable();
}

function tellWaiting(more) {
  waiting += more;
  document.dispatchEvent(new CustomEvent("service-away", { detail: waiting > 0 }));
}

function settle(status, text, key, resolve, reject) {
  if (status < 300) resolve(JSON.parse(text));
  else reject(problemFrom(status, text, key));
}

function problemFrom(status, text, key) {
  let problem = { status, title: `Answer ${status}`, detail: text.slice(0, 500) };
  try {
    problem = { ...problem, ...JSON.parse(text) };
  } catch {
    // Not from the service itself, but from something before it.
  }
  // A late answer to a question that was asked without today's key must not ask for the key again.
  if (status === 401 && key === apiKey.get()) document.dispatchEvent(new CustomEvent("key-needed"));
  return new ProblemError(problem);
}

function unreachable() {
  return new ProblemError({ title: "No answer", detail: "The service does not answer; is it running?" });
}

function credentials() {
  const key = apiKey.get();
  return key ? { "x-api-key": key } : {};
}

function search(query) {
  const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  const text = new URLSearchParams(given).toString();
  return text ? `?${text}` : "";
}

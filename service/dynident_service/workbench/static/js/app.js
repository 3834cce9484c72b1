// Start of the page: which view an address opens, navigation, and the API key.

import { apiKey, get } from "./api.js";
import { beginPage } from "./first_model.js";
import { h, put } from "./dom.js";
import { lookForJobs, watch } from "./jobs.js";
import { address, asked, follow } from "./page_address.js";
import { modelPage } from "./model_page.js";
import { ModelList } from "./model_list.js";
import { problemBox } from "./problem.js";
import { recordingPage } from "./recordings/recording_page.js";

// Views that are read when they are opened: what most visits do without is not waited for.
const VIEWS = {
  models: () => import("./lists/models_page.js"),
  jobs: () => import("./lists/jobs_page.js"),
  robots: () => import("./lists/robots_page.js"),
  recordings: () => import("./lists/recordings_page.js"),
  design: () => import("./design/design_page.js"),
  campaigns: () => import("./campaigns_page.js"),
  changes: () => import("./changes_page.js"),
};
const main = document.getElementById("main");
const list = new ModelList(document.getElementById("models"));
let running = new AbortController();
let shown = null;

/** Show what the address asks for, unless it is shown already. */
async function show({ anew = false } = {}) {
  const wanted = asked();
  const recording = wanted.view === "recording" && wanted.measurement;
  const view = JSON.stringify([wanted.view, wanted.identification, wanted.robot, wanted.design, wanted.campaign, wanted.diagnosis, wanted.pair, wanted.resource, recording]);
  if (view === shown && !anew) return;
  shown = view;
  running.abort();
  running = new AbortController();
  const { signal } = running;
  navigation(wanted.view);
  list.mark(wanted.identification);
  put(main, h("p", { class: "note" }, "Loading …"));
  scrollTo(0, 0);
  try {
    if (wanted.view === "recording") return await recordingPage(main, wanted, signal);
    if (wanted.view === "new") await beginPage(main, wanted, signal);
    else if (VIEWS[wanted.view]) await (await VIEWS[wanted.view]()).page(main, wanted, signal);
    else if (wanted.identification) await modelPage(main, wanted, signal);
    else await firstView(signal);
  } catch (error) {
    if (signal.aborted) return;
    put(main, problemBox(error, () => show({ anew: true })));
    if (!error.status) console.error(error);
  }
}

/** Without a wish: the newest model that is done, or how to begin. */
async function firstView(signal) {
  const { items } = await get("/identifications", { limit: 50, brief: true }, signal);
  const done = items.find((one) => one.status === "succeeded") ?? items[0];
  if (!done) return beginPage(main, {}, signal);
  history.replaceState(null, "", address({ identification: done.id }));
  return show();
}

function navigation(view) {
  const links = [["", "Model"], ["models", "Models"], ["new", "New model"], ["design", "Design"], ["campaigns", "Campaigns"], ["changes", "Changes"], ["robots", "Robots"], ["recordings", "Recordings"], ["jobs", "Jobs"]];
  put(
    document.getElementById("views"),
    links.map(([name, text]) =>
      h("a", { href: address({ view: name }), "aria-current": view === name ? "page" : null }, text),
    ),
  );
}

/** Ask for the key of a service that wants one. */
function askForKey() {
  if (document.querySelector("dialog[open]")) return;
  const input = h("input", { type: "password", id: "api-key", autocomplete: "off", required: true });
  const dialog = h("dialog", { "aria-labelledby": "key-title" },
    h("form", { method: "dialog" },
      h("h2", { id: "key-title" }, "API key"),
      h("p", {}, "This service needs an API key. The key is stored only in this tab."),
      h("label", { for: "api-key" }, "Key"),
      input,
      h("p", {}, h("button", { class: "main" }, "Enter")),
    ),
  );
  dialog.addEventListener("close", () => {
    dialog.remove();
    apiKey.set(input.value);
    list.refresh();
    lookForJobs().catch(() => {});
    show({ anew: true });
  });
  document.body.append(dialog);
  dialog.showModal();
}

document.addEventListener("click", follow);
document.addEventListener("key-needed", askForKey);
document.addEventListener("service-away", ({ detail: away }) =>
  put(document.getElementById("away"), away ? "The service does not answer; trying again …" : null),
);
addEventListener("popstate", () => show());
addEventListener("models-changed", () => list.refresh());
watch(document.getElementById("jobs"));
list.refresh();
show();

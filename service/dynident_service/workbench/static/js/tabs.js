// Tabs whose choice is in the address; built when first opened.

import { h, put } from "./dom.js";
import { asked, go, remember } from "./page_address.js";

const STEPS = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };

/** Tabs from { id, title, sections() }; `first(wanted)` is the one to open where the address names none. */
export function tabs(label, all, first, signal) {
  const made = new Map(all.map((one) => [one.id, parts(one)]));
  const list = h("div", { class: "tabs", role: "tablist", "aria-label": label, onkeydown: (event) => turn(event) }, [...made.values()].map((one) => one.tab));

  function open(id) {
    for (const [name, { tab, panel, sections }] of made) {
      const chosen = name === id;
      tab.setAttribute("aria-selected", String(chosen));
      tab.setAttribute("tabindex", chosen ? "0" : "-1");
      panel.hidden = !chosen;
      if (chosen && !panel.childElementCount) put(panel, sections());
    }
    made.get(id).tab.scrollIntoView({ block: "nearest", inline: "nearest" });
  }

  function turn(event) {
    const names = [...made.keys()];
    const here = names.findIndex((name) => made.get(name).tab === event.target);
    const ends = { Home: 0, End: names.length - 1 };
    const to = STEPS[event.key] ? (here + STEPS[event.key] + names.length) % names.length : ends[event.key];
    if (here < 0 || to === undefined) return;
    event.preventDefault();
    // Walking along the tabs leaves no trace for Back to walk through.
    remember({ tab: names[to] });
    open(names[to]);
    made.get(names[to]).tab.focus();
  }

  const ofAddress = () => {
    const wanted = asked();
    return made.has(wanted.tab) ? wanted.tab : first(wanted);
  };
  addEventListener("popstate", () => signal.aborted || open(ofAddress()), { signal });
  open(ofAddress());
  return [list, [...made.values()].map((one) => one.panel)];
}

/** Open a tab of the page that is shown: a step that Back undoes. */
export function goToTab(tab) {
  go({ ...asked(), tab });
}

function parts({ id, title, sections }) {
  const tab = h("button", { type: "button", role: "tab", id: `tab-${id}`, "aria-controls": `panel-${id}`, onclick: () => goToTab(id) }, title);
  const panel = h("div", { role: "tabpanel", id: `panel-${id}`, "aria-labelledby": tab.id, tabindex: "-1", hidden: true });
  return { tab, panel, sections };
}

// Section of the measurements that a model was fitted to and tested on.

import { figures, h, listed, section } from "./dom.js";
import { grouped, number, quantity } from "./format.js";
import { address } from "./page_address.js";
import { inPageWords } from "./recordings/remedies.js";

/** The measurements of the fit and the held-out ones, each a link to its signals, windows and checks. */
export function dataSection(model) {
  const columns = [
    ["recording", (one) => h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name)],
    ["used for", (one) => (one.heldOut ? "held out" : "fit")],
    figures("samples", (one) => one.n_samples, grouped),
    figures("sampling rate", (one) => one.sampling_rate, (value) => quantity(value, "Hz")),
    ["windows of t", (one) => (one.windows.length ? one.windows.map(([from, to]) => `${number(from)} to ${number(to)} s`).join(", ") : "all")],
    ["checks", (one) => checksInWords(one.checks)],
  ];
  return section("data", "Data",
    listed("Recordings of this model", columns, model.measurements, { id: "data-table" }),
    h("p", { class: "note" }, "A recording's page shows its signals, its windows and what its checks found. ",
      h("a", { href: address({ view: "new", robot: model.robot.id }) }, "Upload more recordings of this robot, or identify again")),
  );
}

function checksInWords(checks) {
  const bad = checks.filter((one) => one.status !== "ok");
  if (!bad.length) return h("span", { class: "mark ok" }, "✓ all passed");
  return h("ul", {}, bad.map((one) => h("li", {}, `${one.name.replaceAll("_", " ")}: `, inPageWords(one.detail, one.remedies))));
}

// What a model was made from and what it was tried on.

import { h, numeric, right, row, section, table } from "./dom.js";
import { grouped, number, quantity } from "./format.js";
import { address } from "./location.js";

/** The measurements of the fit and the held-out ones, each a link to its signals, windows and checks. */
export function dataSection(model) {
  const head = ["measurement", "used for", right("samples"), right("sampling rate"), "windows of t", "checks"];
  const rows = model.measurements.map((one) => row([
    h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name),
    one.heldOut ? "held out" : "fit",
    numeric(grouped(one.n_samples), one.n_samples),
    numeric(quantity(one.sampling_rate, "Hz"), one.sampling_rate),
    one.windows.length ? one.windows.map(([from, to]) => `${number(from)} to ${number(to)} s`).join(", ") : "all of it",
    checksInWords(one.checks),
  ]));
  return section("data", "Data",
    table("Measurements of this model", head, rows, { id: "data-table" }),
    h("p", { class: "note" }, "A measurement's page shows its signals, its windows and what its checks found. ",
      h("a", { href: address({ view: "new", robot: model.robot.id }) }, "Upload more of this robot, or identify anew")),
  );
}

function checksInWords(checks) {
  const bad = checks.filter((one) => one.status !== "ok");
  if (!bad.length) return h("span", { class: "mark ok" }, "✓ all passed");
  return h("ul", {}, bad.map((one) => h("li", {}, `${one.name}: ${one.detail}`)));
}

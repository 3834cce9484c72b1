// Page of all recordings: robot, length, checks.

import { h } from "../dom.js";
import { grouped, number } from "../format.js";
import { address } from "../page_address.js";
import { dateColumn, figureColumn, labelColumns, plainColumn } from "./common_columns.js";
import { robotNames } from "./paged_lists.js";
import { resourcesPage } from "./resource_page.js";

export async function page(target, wanted, signal) {
  document.title = "Recordings: dynident";
  const robots = await robotNames(signal);
  const columns = (changed) => [
    { id: "name", name: "name", value: (one) => one.name, cell: (one) => h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name) },
    { id: "robot", name: "robot", value: (one) => robots.get(one.robot_id) ?? "", cell: (one) => h("a", { href: address({ view: "new", robot: one.robot_id }) }, robots.get(one.robot_id) ?? one.robot_id) },
    { ...plainColumn("role", "use", (one) => one.role ?? ""), cell: (one) => one.role ?? "–" },
    figureColumn("samples", "samples", (one) => one.n_samples, grouped),
    figureColumn("duration", "duration", (one) => (one.under_way ? null : one.n_samples / one.sampling_rate), (value) => `${number(value)} s`),
    figureColumn("rate", "rate", (one) => (one.under_way ? null : one.sampling_rate), (value) => `${number(value)} Hz`),
    plainColumn("checks", "checks", worst),
    dateColumn(),
    ...labelColumns("/measurements", changed),
  ];
  await resourcesPage(target, { title: "Recordings", path: "/measurements", noun: "recording", columns, id: "recordings-table", empty: "No recording yet: choose a robot under New model and drop its files there." }, wanted, signal);
}

function worst({ checks }) {
  const levels = checks.map((one) => one.status);
  return levels.includes("error") ? "error" : levels.includes("warning") ? "warning" : "ok";
}

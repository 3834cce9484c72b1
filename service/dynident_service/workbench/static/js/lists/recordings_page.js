// All recordings: of which robot, how long, and what their checks say.

import { h } from "../dom.js";
import { grouped, moment, number } from "../format.js";
import { address } from "../location.js";
import { labelsButton, tagChips } from "./labels.js";
import { robotNames } from "./reading.js";
import { resourcesPage } from "./resources.js";

export async function page(target, wanted, signal) {
  document.title = "Recordings: dynident";
  const robots = await robotNames(signal);
  const columns = (changed) => [
    { id: "name", name: "name", value: (one) => one.name, cell: (one) => h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name) },
    { id: "robot", name: "robot", value: (one) => robots.get(one.robot_id) ?? "", cell: (one) => h("a", { href: address({ view: "new", robot: one.robot_id }) }, robots.get(one.robot_id) ?? one.robot_id) },
    { id: "role", name: "use", value: (one) => one.role ?? "", cell: (one) => one.role ?? "–" },
    { id: "samples", name: "samples", right: true, value: (one) => one.n_samples, text: () => "", cell: (one) => grouped(one.n_samples) },
    { id: "duration", name: "duration", right: true, value: (one) => one.n_samples / one.sampling_rate, text: () => "", cell: (one) => `${number(one.n_samples / one.sampling_rate)} s` },
    { id: "rate", name: "rate", right: true, value: (one) => one.sampling_rate, text: () => "", cell: (one) => `${number(one.sampling_rate)} Hz` },
    { id: "checks", name: "checks", value: (one) => worst(one), cell: (one) => worst(one) },
    { id: "date", name: "date", value: (one) => one.created_at, text: (one) => moment(one.created_at), cell: (one) => moment(one.created_at) },
    { id: "tags", name: "tags", value: (one) => one.tags.join(" "), cell: (one) => tagChips(one) },
    { id: "acts", name: "", cell: (one) => labelsButton(`/measurements/${one.id}`, one, changed(one)) },
  ];
  await resourcesPage(target, { title: "Recordings", path: "/measurements", noun: "recording", columns, id: "recordings-table", empty: "No recording yet: choose a robot under New model and drop its files there." }, wanted, signal);
}

function worst({ checks }) {
  const levels = checks.map((one) => one.status);
  return levels.includes("error") ? "error" : levels.includes("warning") ? "warning" : "ok";
}

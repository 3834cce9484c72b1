// All robots, and where to go with one.

import { h } from "../dom.js";
import { moment } from "../format.js";
import { address } from "../location.js";
import { labelsButton, tagChips } from "./labels.js";
import { resourcesPage } from "./resources.js";

export function page(target, wanted, signal) {
  document.title = "Robots: dynident";
  const columns = (changed) => [
    { id: "name", name: "name", value: (one) => one.name, cell: (one) => one.name },
    { id: "joints", name: "joints", right: true, value: (one) => one.joints.length, text: (one) => one.joints.map((joint) => joint.name).join(" "), cell: (one) => h("span", { title: one.joints.map((joint) => joint.name).join(", ") }, String(one.joints.length)) },
    { id: "base", name: "base parameters", right: true, value: (one) => one.base_parameters.count, text: () => "", cell: (one) => String(one.base_parameters.count) },
    { id: "gains", name: "drive gains", value: (one) => gains(one), cell: (one) => gains(one) },
    { id: "date", name: "date", value: (one) => one.created_at, text: (one) => moment(one.created_at), cell: (one) => moment(one.created_at) },
    { id: "tags", name: "tags", value: (one) => one.tags.join(" "), cell: (one) => tagChips(one) },
    { id: "acts", name: "", cell: (one) => [h("a", { href: address({ view: "new", robot: one.id }) }, "Identify"), " ", h("a", { href: address({ view: "design", robot: one.id }) }, "Design"), " ", labelsButton(`/robots/${one.id}`, one, changed(one))] },
  ];
  return resourcesPage(target, { title: "Robots", path: "/robots", noun: "robot", columns, id: "robots-table", empty: "No robot yet: a new model begins with one." }, wanted, signal);
}

function gains({ joints }) {
  const known = joints.filter((joint) => joint.drive_gain !== null).length;
  return known ? `${known} of ${joints.length}` : "none";
}

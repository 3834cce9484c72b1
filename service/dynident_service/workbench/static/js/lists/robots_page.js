// Page of all robots.

import { h } from "../dom.js";
import { address } from "../page_address.js";
import { dateColumn, figureColumn, labelColumns, plainColumn } from "./common_columns.js";
import { resourcesPage } from "./resource_page.js";

export function page(target, wanted, signal) {
  document.title = "Robots: dynident";
  const columns = (changed) => [
    plainColumn("name", "name", (one) => one.name),
    { id: "joints", name: "joints", right: true, value: (one) => one.joints.length, text: (one) => one.joints.map((joint) => joint.name).join(" "), cell: (one) => h("span", { title: one.joints.map((joint) => joint.name).join(", ") }, String(one.joints.length)) },
    figureColumn("base", "base parameters", (one) => one.base_parameters.count),
    plainColumn("gains", "drive gains", gains),
    dateColumn(),
    ...labelColumns("/robots", changed, (one) => [h("a", { href: address({ view: "new", robot: one.id }) }, "Identify"), " ", h("a", { href: address({ view: "design", robot: one.id }) }, "Design"), " "]),
  ];
  return resourcesPage(target, { title: "Robots", path: "/robots", noun: "robot", columns, id: "robots-table", empty: "No robot yet: a new model begins with one." }, wanted, signal);
}

function gains({ joints }) {
  const known = joints.filter((joint) => joint.drive_gain !== null).length;
  return known ? `${known} of ${joints.length}` : "none";
}

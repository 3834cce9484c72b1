// Section of measured against predicted torque, and the worst intervals.

import { CompareStack } from "./compare/joint_stack.js";
import { field, h, jointButton, put, section, select } from "./dom.js";
import { awaited } from "./jobs.js";
import { address, remember } from "./page_address.js";
import { problemBox } from "./problem.js";
import { byName, foldedTable, shownTable } from "./tables.js";

/** Compares by itself as soon as the section is there. */
export function torqueSection(model, signal) {
  const body = h("div");
  const figures = new CompareStack(model, signal);
  const worst = h("div");
  const joints = h("div", { class: "choices", role: "group", "aria-label": "Joint" });
  const showJoints = () => put(joints, model.joints.map((joint) => jointButton(model, joint)));
  const measurement = select(
    model.measurements.map((one) => [one.id, `${one.name} (${one.heldOut ? "held out" : "fit"})`]),
    model.measurement,
    (id) => model.chooseMeasurement(id),
  );

  const source = h("span");
  const compare = async () => {
    const wanted = model.measurement;
    put(source, h("a", { href: address({ view: "recording", measurement: wanted }) }, "its signals, windows and checks"));
    put(body, h("p", { class: "note" }, "Comparing …"));
    try {
      const asked = await model.comparedWith(wanted, signal);
      const comparison = asked.status === "succeeded" ? asked : await awaited("/comparisons", asked, "Comparing", body, signal);
      if (signal.aborted || wanted !== model.measurement) return;
      put(worst);
      put(body, figures.element, worst);
      const { chosen, all } = figures.show(comparison);
      // What else there is to draw is asked for once the first figure is there.
      await chosen;
      if (signal.aborted || wanted !== model.measurement) return;
      model.setComparison(comparison);
      put(worst, worstIntervals(model));
      await all;
    } catch (error) {
      if (!signal.aborted) put(body, problemBox(error, compare));
    }
  };

  model.addEventListener("joint", () => {
    showJoints();
    figures.shape();
  });
  model.addEventListener("limb", () => figures.shape());
  model.addEventListener("zoom", ({ detail }) => {
    // The joint that comes with a zoom is drawn first.
    queueMicrotask(() => figures.zoom(model.joint, detail));
    figures.element.scrollIntoView({ block: "nearest", behavior: "smooth" });
    figures.announce(model.joint, detail);
  });
  model.addEventListener("measurement", () => {
    remember({ from: "", to: "" });
    compare();
  });
  showJoints();
  compare();
  return section("torque", "Measured against predicted torque",
    h("div", { class: "bar-of-fields" }, field("Recording", measurement), source, joints),
    body,
  );
}

/** Errors beside the noise, and the worst intervals, each a button that shows it. */
function worstIntervals(model) {
  const { worst, notes } = model.comparison.result;
  const tables = byName(model.comparison);
  const when = (content, k) => h("button", { type: "button", class: "small", onclick: () => model.zoomTo(worst[k].joint, worst[k].from, worst[k].to) }, content);
  return [
    notes.length ? h("ul", { class: "note", id: "comparison-notes" }, notes.map((one) => h("li", {}, one))) : null,
    foldedTable(tables.comparison, { id: "over-noise" }),
    tables.worst ? shownTable(tables.worst, { id: "worst" }, { wrap: { 1: when } }) : null,
  ];
}

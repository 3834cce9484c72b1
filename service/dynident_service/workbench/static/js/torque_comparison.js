// Section of measured against predicted torque, and the worst intervals.

import { CompareStack } from "./compare/joint_stack.js";
import { field, h, jointButton, put, section, select } from "./dom.js";
import { number, percent, positionUnit, quantity } from "./format.js";
import { awaited } from "./jobs.js";
import { address, remember } from "./page_address.js";
import { problemBox } from "./problem.js";
import { shownTable } from "./tables.js";

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
      put(worst, worstStretches(model));
      await all;
    } catch (error) {
      if (!signal.aborted) put(body, problemBox(error, compare));
    }
  };

  model.addEventListener("joint", () => {
    showJoints();
    figures.shape();
  });
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
    h("div", { class: "bar-of-fields" }, field("Measurement", measurement), source, joints),
    body,
  );
}

function worstStretches(model) {
  const { worst, relative_total: total, moving, notes } = model.comparison.result;
  const both = moving ? `${percent(moving.relative_total)} where they move, ${percent(total)} on all rows` : percent(total);
  if (!worst.length) return null;
  const pose = (one) => (one.pose.length ? model.joints.map((joint, index) => `${joint} ${quantity(one.pose[index], positionUnit(model.unitOf(joint)))}`).join(", ") : "");
  const buttons = worst.map((one) => {
    const text = `${one.joint}: ${number(one.from, 4)} to ${number(one.to, 4)} s`;
    const size = `${quantity(one.rms, model.unitOf(one.joint))} rms, ${number(one.ratio, 2)} × the joint's rms`;
    const units = new Set(model.joints.map((joint) => positionUnit(model.unitOf(joint))));
    const short = units.size === 1 ? `pose ${one.pose.map((value) => number(value, 2)).join(", ")} ${[...units][0]}` : pose(one);
    const where = pose(one);
    return h("li", {}, h("button", { type: "button", class: "small", onclick: () => model.zoomTo(one.joint, one.from, one.to) }, text), h("span", { title: where ? `at ${number(one.time, 4)} s: ${where}` : null }, size, where ? h("small", { class: "note" }, h("br"), short) : null));
  });
  const overNoise = model.comparison.tables.map((one) => h("details", {}, h("summary", {}, "Residual against the noise"), shownTable(one, { id: "over-noise" })));
  const remarks = notes.length ? h("ul", { class: "note", id: "comparison-notes" }, notes.map((one) => h("li", {}, one))) : null;
  return [remarks, overNoise, h("h3", {}, "Worst intervals"), h("p", { class: "note" }, `Error on this measurement, all joints: ${both}. Choose an interval to see it.`), h("ol", { class: "worst" }, buttons)];
}

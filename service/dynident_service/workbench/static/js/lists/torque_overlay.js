// Figure of the torques that two models predict on one recording.

import { Reader } from "../compare/signal_reader.js";
import { field, h, part, put, select } from "../dom.js";
import { judged } from "../joint_errors.js";
import { number } from "../format.js";
import { awaited } from "../jobs.js";
import { requestedComparison } from "../shown_model.js";
import { axis, colour, onColours, timeAxis, told } from "../plots.js";
import { problemBox } from "../problem.js";
import { redraw, timePlot } from "../signals/time_plot.js";
import { TimeView, timeButtons, timeGroup } from "../signals/time_view.js";

const HEIGHTS = { torque: 260, residual: 180 };

/** Measured torque with both predictions, and both residuals, of a recording and a joint that are chosen here. */
export function overlaySection(models, names, signal) {
  const joints = models[0].result.joints.filter((joint) => models[1].result.joints.includes(joint));
  const of = (model) => [...model.request.validation_ids, ...model.request.measurement_ids];
  const seen = new Map(models.flatMap((one) => one.result.measurements ?? []).map((one) => [one.id, one.name]));
  const shared = of(models[0]).filter((id) => of(models[1]).includes(id));
  if (!joints.length || !shared.length) return part("Torques", h("p", { class: "note" }, "The two models have no recording in common."));
  const state = { joint: mostDifferent(models, joints), measurement: shared[0], lines: [] };
  const view = new TimeView();
  const said = h("div");
  const places = { torque: h("div", { class: "chart", id: "overlay-torque" }), residual: h("div", { class: "chart", id: "overlay-residual" }) };
  const group = timeGroup(view, "Torque that both models predict, over time.");
  group.append(places.torque, places.residual);
  const plots = {};

  const read = async () => {
    const { joint, measurement } = state;
    try {
      const comparisons = await Promise.all(models.map((one) => requestedComparison(one.id, measurement, signal).then((made) => awaited("/comparisons", made, "Comparing", said, signal))));
      const lines = await Promise.all(comparisons.map((one) => new Promise((resolve, reject) => {
        new Reader(one, [joint], (_, line) => resolve(line), signal).read(null, joint).catch(reject);
      })));
      if (signal.aborted || joint !== state.joint || measurement !== state.measurement) return;
      state.lines = lines;
      view.setWhole(lines[0].x[0], lines[0].x.at(-1));
      draw();
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error, read));
    }
  };
  const draw = () => {
    if (!state.lines.length) return;
    const [first, second] = state.lines;
    const { unit } = first;
    const value = told((raw) => `${number(raw)} ${unit}`);
    const line = (label, stroke, width = 1.2) => ({ label, stroke, width, points: { show: false }, value });
    const colours = [colour("predicted"), colour("residual")];
    const at = (name) => [first.values[name], onTimesOf(first, second, name)];
    // At rest a prediction has no sign of friction, so none is drawn there.
    const { standing } = first.values;
    const moving = (values) => (standing ? values.map((value, index) => (standing[index] ? null : value)) : values);
    const kinds = {
      torque: [[line("measured", colour("measured"), 1.6), ...names.map((name, index) => line(name, colours[index]))], [first.values.measured, ...at("predicted").map(moving)]],
      residual: [names.map((name, index) => line(`residual of ${name}`, colours[index])), at("residual")],
    };
    for (const [kind, [series, values]] of Object.entries(kinds)) {
      plots[kind]?.destroy();
      const time = { label: "time", value: told((raw) => `${number(raw, 5)} s`) };
      const options = { height: HEIGHTS[kind], series: [time, ...series], axes: [timeAxis("time (s)"), axis(`${kind} (${unit})`, 3)], legend: { show: true, live: true } };
      plots[kind] = timePlot(places[kind], view, { options, data: [[], ...series.map(() => [])], linked: "overlay" }, signal);
      redraw(plots[kind], view, [first.x, ...values]);
    }
  };
  view.addEventListener("stretch", () => Object.values(plots).forEach((one) => redraw(one, view)), { signal });
  onColours(draw, signal);
  const choose = (name) => (value) => {
    state[name] = value;
    read();
  };
  read();
  return part("Torques",
    h("div", { class: "bar-of-fields" }, field("Recording", select(shared.map((id) => [id, seen.get(id) ?? id]), shared[0], choose("measurement"))), field("Joint", select(joints.map((one) => [one, one]), state.joint, choose("joint")))),
    timeButtons(view), said, group);
}

/** The joint whose errors differ most between the models. */
function mostDifferent(models, joints) {
  const errorOf = ({ result }, joint) => judged(result.validation ?? result.residual).relative[result.joints.indexOf(joint)] ?? 0;
  const difference = (joint) => Math.abs(errorOf(models[0], joint) - errorOf(models[1], joint));
  return joints.reduce((best, joint) => (difference(joint) > difference(best) ? joint : best));
}

/** A signal of the second line at the times of the first: filters of two models may leave other samples. */
function onTimesOf(first, second, name) {
  const values = second.values[name];
  if (first.x.length === second.x.length && first.x.every((time, index) => time === second.x[index])) return values;
  let at = 0;
  return first.x.map((time) => {
    while (at < second.x.length - 1 && Math.abs(second.x[at + 1] - time) <= Math.abs(second.x[at] - time)) at += 1;
    return time === null ? null : values[at];
  });
}

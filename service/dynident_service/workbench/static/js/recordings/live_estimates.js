// What a recording under way tells so far: parameters with their uncertainty, error over time, reasons to stop.

import { follow, ProblemError } from "../api.js";
import { h, listed, put, right, section } from "../dom.js";
import { counted, estimated, percent, quantity } from "../format.js";
import { colour, figure, onColours } from "../plots.js";
import { problemBox } from "../problem.js";

/** The section of a recording under way: { element, run() }; `onFinished` is called once the last rows have come. */
export function liveSection(measurement, signal, onFinished) {
  const state = h("p", { id: "live-state", role: "status" }, "Waiting for rows.");
  const stop = h("div", { id: "live-stop" });
  const chart = h("div", { class: "chart", id: "live-chart" });
  const parameters = h("div", { id: "live-parameters" });
  const course = [];
  const draw = () => chart.isConnected && course.length > 1 && errorOverTime(chart, course, signal);
  onColours(draw, signal);

  const show = (estimate) => {
    const errors = (estimate.error ?? []).filter((one) => one !== null);
    if (errors.length) course.push({ seconds: estimate.seconds, fit: Math.max(...errors), predicted: worst(estimate.predicted) });
    const length = estimate.seconds ? `, ${quantity(estimate.seconds, "s", 3)}` : "";
    put(state, `${counted(estimate.rows, "row")}${length}. ${estimate.reason}`);
    put(stop, estimate.stop.length ? h("div", { class: "box error" }, h("p", {}, "Stop the robot: this run is not worth going on with."), h("ul", {}, estimate.stop.map((one) => h("li", {}, one.detail)))) : null);
    put(parameters, estimate.parameters.length ? parameterTable(estimate.parameters) : null);
    draw();
  };

  const run = async () => {
    try {
      for await (const event of follow(`/measurements/${measurement.id}/estimates`, signal)) {
        if (event.kind === "problem") throw new ProblemError(event);
        show(event);
        if (event.kind === "finished") await onFinished();
      }
    } catch (error) {
      if (!signal.aborted) put(state, problemBox(error));
    }
  };
  return { element: section("live", "Estimates while it is recorded", state, stop, chart, parameters), run };
}

function worst(errors) {
  const known = (errors ?? []).filter((one) => one !== null);
  return known.length ? Math.max(...known) : null;
}

function inPercent(error) {
  return error === null ? null : 100 * error;
}

function parameterTable(parameters) {
  const columns = [
    ["parameter", (one) => one.name],
    ["joint", (one) => one.link],
    [right("value"), (one) => ({ class: "n", text: estimated(one.value, one.standard_deviation) })],
    ["unit", (one) => one.unit],
    ["judgement", (one) => one.judgement.replaceAll("_", " ")],
  ];
  return listed("Parameters so far, with their standard deviation", columns, parameters, { class: "narrow" });
}

function errorOverTime(chart, course, signal) {
  figure(chart, {
    title: "Error of the torque, worst joint",
    x: { label: "time (s)", words: (raw) => quantity(raw, "s"), values: course.map((one) => one.seconds) },
    y: { label: "error (%)", words: (raw) => percent(raw / 100), scale: { range: (_, __, high) => [0, 1.08 * (high || 1)] } },
    lines: [
      { label: "left by the fit", stroke: colour("residual"), width: 2, values: course.map((one) => inPercent(one.fit)) },
      { label: "newest rows, before they were fitted", stroke: colour("predicted"), width: 2, values: course.map((one) => inPercent(one.predicted)) },
    ],
  }, signal);
}

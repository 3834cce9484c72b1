// Spectra of a joint's residual, over time and over its own angle, and its autocorrelation.

import { get, lastAsked } from "./api.js";
import { h, put, section } from "./dom.js";
import { number, quantity } from "./format.js";
import { axis, colour, onColours, plot } from "./plots.js";

const LINES = 3;

/** Follows the joint and the comparison. */
export function spectraSection(model, signal) {
  const figures = h("div", { class: "profiles", id: "spectra" });
  const drawing = lastAsked(signal);

  const draw = () => {
    const mine = drawing();
    const { comparison, joint } = model;
    if (!comparison) return;
    const targets = [0, 1, 2].map(() => h("div", { class: "chart" }));
    put(figures, targets);
    const below = (path, query) => get(`/comparisons/${comparison.id}/${path}`, { joint, ...query }, mine);
    shown(targets[0], below("spectrum", { over: "time" }), paintSpectrum, mine);
    shown(targets[1], below("spectrum", { over: "angle" }), paintSpectrum, mine);
    shown(targets[2], below("autocorrelation", {}), paintMemory, mine);
  };
  model.addEventListener("comparison", draw);
  model.addEventListener("joint", draw);
  return section("spectra", "Spectra of the residual",
    h("p", { class: "note" }, "A line over time is vibration; a line over the joint's position comes from its gears or its motor. A residual that remembers is not noise."),
    figures,
  );
}

async function shown(target, answer, paint, until) {
  try {
    const found = await answer;
    if (until.aborted) return;
    const draw = () => paint(target, found, until);
    onColours(draw, until);
    draw();
  } catch (error) {
    // A joint that stands still has no spectrum over its angle: said, not complained of.
    if (!until.aborted) put(target, h("p", { class: "note" }, error.message));
  }
}

function paintSpectrum(target, found, until) {
  const overAngle = found.over === "angle";
  const turns = overAngle && found.frequency_unit === "cycles/rad";
  const scale = turns ? 2 * Math.PI : 1;
  const unit = turns ? "per turn" : overAngle ? "per metre" : "Hz";
  const x = found.frequency.map((one) => scale * one);
  const value = (_, raw) => (raw === null || raw === undefined ? "–" : quantity(raw, found.effort_unit));
  const name = overAngle ? "cycles" : "frequency";
  const options = {
    height: 190,
    series: [
      { label: name, value: (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw)} ${unit}`) },
      { label: "amplitude", stroke: colour("residual"), width: 1.2, fill: colour("band-wash"), points: { show: false }, value },
    ],
    scales: { x: { time: false }, y: { range: (_, low, high) => [0, 1.1 * (high || 1)] } },
    axes: [axis(`${name} (${unit})`, 2), axis(`amplitude (${found.effort_unit})`, 3)],
    cursor: { drag: { x: false, y: false } },
    legend: { live: true },
  };
  put(target, h("p", { class: "chart-title" }, `Residual of ${found.joint} over ${overAngle ? "its position" : "time"}`));
  plot(target, options, [x, found.amplitude], until);
  const lines = found.peaks.slice(0, LINES).map((one) => `${quantity(scale * one.frequency, unit)} (${quantity(one.amplitude, found.effort_unit)})`);
  if (lines.length) target.append(h("p", { class: "note" }, `Highest: ${lines.join(", ")}.`));
}

function paintMemory(target, found, until) {
  const band = (sign) => found.lag.map(() => sign * found.limit);
  const value = (_, raw) => (raw === null || raw === undefined ? "–" : number(raw));
  const edge = { class: "edge", stroke: "transparent", width: 0, points: { show: false }, value };
  const options = {
    height: 190,
    series: [
      { label: "lag", value: (_, raw) => (raw === null || raw === undefined ? "–" : quantity(raw, "s")) },
      { ...edge, label: "95 % upper" },
      { ...edge, label: "lower" },
      { label: "autocorrelation", stroke: colour("residual"), width: 1.5, points: { show: false }, value },
    ],
    scales: { x: { time: false }, y: { range: (_, low, high) => [Math.min(-0.2, low ?? 0), Math.max(1, high ?? 1)] } },
    axes: [axis("lag (s)", 2), axis("autocorrelation", 3)],
    bands: [{ series: [1, 2], fill: colour("band-wash") }],
    cursor: { drag: { x: false, y: false } },
    legend: { live: true },
  };
  put(target, h("p", { class: "chart-title" }, `How long the residual of ${found.joint} remembers`));
  plot(target, options, [found.lag, band(1), band(-1), found.value], until);
  target.append(h("p", { class: "note" }, `Its ${found.n_samples} samples are worth ${number(found.effective_samples)} independent ones; the wash is where independent ones would stay.`));
}

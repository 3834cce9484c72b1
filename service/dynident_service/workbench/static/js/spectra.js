// Figures of a joint's residual spectra (time, angle) and autocorrelation.

import { get, lastAsked } from "./api.js";
import { h, put, section } from "./dom.js";
import { number, quantity } from "./format.js";
import { colour, drawn, figure } from "./plots.js";

const LINES = 3;

/** Follows the joint and the comparison. */
export function spectraSection(model, signal) {
  const place = h("div", { class: "profiles", id: "spectra" });
  const drawing = lastAsked(signal);

  const draw = () => {
    const mine = drawing();
    const { comparison, joint } = model;
    if (!comparison) return;
    const targets = [0, 1, 2].map(() => h("div", { class: "chart" }));
    put(place, targets);
    const figures = [["spectrum", { over: "time" }, paintSpectrum], ["spectrum", { over: "angle" }, paintSpectrum], ["autocorrelation", {}, paintMemory]];
    figures.forEach(([path, query, paint], k) => {
      const answer = get(`/comparisons/${comparison.id}/${path}`, { joint, ...query }, mine);
      // A joint that stands still has no spectrum over its angle: said, not complained of.
      drawn(answer, (found) => paint(targets[k], found, mine), mine, (error) => put(targets[k], h("p", { class: "note" }, error.message)));
    });
  };
  model.addEventListener("comparison", draw);
  model.addEventListener("joint", draw);
  return section("spectra", "Spectra of the residual",
    h("p", { class: "note" }, "A peak over time is vibration; a peak over the joint's position comes from its gears or its motor. A residual with autocorrelation is not noise."),
    place,
  );
}

function paintSpectrum(target, found, until) {
  const overAngle = found.over === "angle";
  const turns = overAngle && found.frequency_unit === "cycles/rad";
  const scale = turns ? 2 * Math.PI : 1;
  const unit = turns ? "per turn" : overAngle ? "per metre" : "Hz";
  const name = overAngle ? "cycles" : "frequency";
  figure(target, {
    title: `Residual of ${found.joint} over ${overAngle ? "its position" : "time"}`,
    x: { name, label: `${name} (${unit})`, words: (raw) => `${number(raw)} ${unit}`, values: found.frequency.map((one) => scale * one) },
    y: { label: `amplitude (${found.effort_unit})`, words: (raw) => quantity(raw, found.effort_unit), scale: { range: (_, low, high) => [0, 1.1 * (high || 1)] } },
    lines: [{ label: "amplitude", values: found.amplitude, stroke: colour("residual"), width: 1.2, fill: colour("band-wash") }],
  }, until);
  const peaks = found.peaks.slice(0, LINES).map((one) => `${quantity(scale * one.frequency, unit)} (${quantity(one.amplitude, found.effort_unit)})`);
  if (peaks.length) target.append(h("p", { class: "note" }, `Highest: ${peaks.join(", ")}.`));
}

function paintMemory(target, found, until) {
  figure(target, {
    title: `Autocorrelation of the residual of ${found.joint}`,
    x: { name: "lag", label: "lag (s)", words: (raw) => quantity(raw, "s"), values: found.lag },
    y: { label: "autocorrelation", words: number, scale: { range: (_, low, high) => [Math.min(-0.2, low ?? 0), Math.max(1, high ?? 1)] } },
    band: { names: ["95 % upper", "lower"], ends: [1, -1].map((sign) => found.lag.map(() => sign * found.limit)) },
    lines: [{ label: "autocorrelation", values: found.value, stroke: colour("residual"), width: 1.5 }],
  }, until);
  target.append(h("p", { class: "note" }, `Its ${found.n_samples} samples are worth ${number(found.effective_samples)} independent ones; independent ones would stay inside the shaded band.`));
}

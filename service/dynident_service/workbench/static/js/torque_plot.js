// Two linked figures over time: measured against predicted torque, and the residual with its band.

import { get, lastAsked } from "./api.js";
import { h, put } from "./dom.js";
import { number, percent } from "./format.js";
import { axis, colour, onColours, plot, symmetric } from "./plots.js";
import { problemBox } from "./problem.js";
import { find, timeline } from "./timeline.js";

const POINTS = 2000;
const SIGNALS = ["measured", "predicted", "lower", "upper", "standing", "residual", "band"];
const STILL = { left: 0, top: 0, width: 0, height: 0 };

export class TorquePlot {
  constructor(signal) {
    this.signal = signal;
    this.reading = lastAsked(signal);
    this.above = h("div", { class: "chart", id: "torque-chart" });
    this.below = h("div", { class: "chart", id: "residual-chart" });
    this.said = h("p", { class: "note", id: "zoom-state" });
    this.trouble = h("div");
    this.keys = { ArrowLeft: () => this.pan(-0.25), ArrowRight: () => this.pan(0.25), "+": () => this.scale(0.5), "-": () => this.scale(2), Escape: () => this.whole() };
    this.element = h(
      "div",
      {},
      this.#buttons(),
      this.trouble,
      h("div", { class: "charts", tabindex: "0", role: "group", "aria-label": "Torque and residual over time. Arrow keys move, plus and minus zoom, Escape shows all.", onkeydown: (event) => this.#key(event) }, this.above, this.below),
      this.said,
    );
    onColours(() => this.#draw(), signal);
  }

  /** Show a joint of a comparison, all of it or a stretch of time. */
  async show(comparison, joint, stretch = null) {
    Object.assign(this, { comparison, joint, stretch: null, full: null });
    await this.#read(null);
    if (stretch && this.full) this.zoom(stretch);
  }

  /** Zoom to a stretch of the recording's time. */
  zoom({ from, to }) {
    if (!this.full) return;
    const room = 0.25 * (to - from);
    const place = this.full.shifted ? find(this.full, from, to, this.full.values.residual) : { from, to };
    if (place) this.#go({ from: place.from - room, to: place.to + room });
  }

  whole() {
    this.#go(null);
  }

  scale(factor) {
    const { from, to } = this.#range();
    const [middle, half] = [(from + to) / 2, ((to - from) / 2) * factor];
    this.#go({ from: middle - half, to: middle + half });
  }

  pan(share) {
    const { from, to } = this.#range();
    const step = share * (to - from);
    this.#go({ from: from + step, to: to + step });
  }

  #key(event) {
    const act = this.keys[event.key];
    if (!act || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    act();
  }

  #buttons() {
    const button = (text, act) => h("button", { type: "button", class: "small", onclick: act }, text);
    return h(
      "p",
      { class: "actions" },
      button("Whole recording", () => this.whole()),
      button("Zoom in", () => this.scale(0.5)),
      button("Zoom out", () => this.scale(2)),
      button("← Earlier", () => this.pan(-0.5)),
      button("Later →", () => this.pan(0.5)),
      h("span", { class: "note" }, "or drag over a stretch; double click shows all"),
    );
  }

  #range() {
    const x = this.full?.x ?? [0, 1];
    return this.stretch ?? { from: x[0], to: x.at(-1) };
  }

  #go(stretch) {
    if (!this.full) return;
    const [first, last] = [this.full.x[0], this.full.x.at(-1)];
    if (stretch) {
      const from = Math.max(first, Math.min(stretch.from, last - 1e-3));
      const to = Math.min(last, Math.max(stretch.to, from + 1e-3));
      stretch = to - from > 0.999 * (last - first) ? null : { from, to };
    }
    this.stretch = stretch;
    // Runs set one after another have no time of their own to ask for: what is there is shown larger.
    if (this.full.shifted || !stretch) {
      this.reading();
      this.#set(this.full);
    } else this.#read(stretch);
  }

  async #read(stretch) {
    const mine = this.reading();
    const query = { joint: this.joint, points: POINTS, ...(stretch ?? {}) };
    try {
      const series = await get(`/comparisons/${this.comparison.id}/series`, query, mine);
      if (mine.aborted) return;
      const line = timeline(series, SIGNALS);
      line.unit = series.effort_unit;
      line.samples = series.n_samples;
      if (!stretch) this.full = line;
      put(this.trouble);
      this.#set(line);
    } catch (error) {
      if (!mine.aborted) put(this.trouble, problemBox(error));
    }
  }

  #set(line) {
    this.line = line;
    const drawn = this.drawn === `${this.joint} ${line.unit} ${this.full?.shifted}`;
    if (drawn) this.#fill();
    else this.#draw();
  }

  #draw() {
    if (!this.line) return;
    for (const one of this.plots ?? []) one.destroy();
    const { unit } = this.line;
    this.drawn = `${this.joint} ${unit} ${this.full?.shifted}`;
    const value = (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw)} ${unit}`);
    const band = { class: "edge", stroke: "transparent", width: 0, points: { show: false }, value };
    const wash = { series: [1, 2], fill: colour("band-wash") };
    const rest = { series: [3, 4], fill: colour("rest-wash") };
    const time = this.full?.shifted ? "time, runs one after another (s)" : "time (s)";
    const line = (label, stroke, width = 1) => ({ label, stroke, width, points: { show: false }, value });
    const first = { label: "time", value: (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw, 5)} s`) };
    this.plots = [
      this.#plot(this.above, 250, `torque (${unit})`, time, [first, { ...band, label: "95 % upper" }, { ...band, label: "lower" }, { ...band, label: "friction may hold" }, { ...band, label: "down to" }, line("measured", colour("measured"), 1.6), line("predicted", colour("predicted"), 1.2)], [wash, rest], undefined),
      this.#plot(this.below, 200, `residual (${unit})`, time, [first, { ...band, label: "95 % upper" }, { ...band, label: "lower" }, line("residual", colour("residual"), 1)], [wash], symmetric),
    ];
    this.#fill();
  }

  #plot(target, height, label, time, series, bands, range) {
    const cursor = {
      sync: { key: "torque", setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
      drag: { x: true, y: false, setScale: false },
      bind: { dblclick: () => () => this.whole() },
      points: { size: 6 },
    };
    const hooks = { setSelect: [(one) => this.#selected(one)], drawClear: [(one) => shade(one, this.line)] };
    const scales = { x: { time: false }, y: range ? { range } : {} };
    const options = { height, cursor, hooks, scales, series, bands, axes: [axis(time, 2), axis(label, 3)], legend: { live: true } };
    return plot(target, options, series.map(() => []), this.signal);
  }

  #selected(one) {
    const { left, width } = one.select;
    if (width < 4) return;
    const [from, to] = [one.posToVal(left, "x"), one.posToVal(left + width, "x")];
    one.setSelect(STILL, false);
    this.#go({ from, to });
  }

  #fill() {
    const { x, values, samples } = this.line;
    const { measured, predicted, lower, upper, standing, residual, band } = values;
    const plus = (centre, sign) => band.map((half, index) => (half === null ? null : (centre ? centre[index] : 0) + sign * half));
    const where = (rests, signal) => signal.map((value, index) => (standing[index] === rests ? value : null));
    const [above, below] = this.plots;
    // At rest the prediction has no sign of friction: what friction may hold stands in its place.
    above.setData([x, where(false, plus(predicted, 1)), where(false, plus(predicted, -1)), where(true, upper), where(true, lower), measured, where(false, predicted)], false);
    below.setData([x, plus(null, 1), plus(null, -1), residual], false);
    const { from, to } = this.#range();
    for (const one of this.plots) one.setScale("x", { min: from, max: to });
    const moving = where(false, residual);
    const outside = moving.filter((value, index) => value !== null && Math.abs(value) > band[index]).length;
    const drawn = residual.filter((value) => value !== null).length;
    const all = drawn === samples;
    const count = moving.filter((value) => value !== null).length;
    const band95 = all && count ? `${percent(outside / count, 2)} of the residual is outside its 95 % band; noise alone leaves 5 % there.` : "Noise alone leaves 5 % of the residual outside its 95 % band.";
    const rest = standing.includes(true) ? " On the grey ground the joint stands: there the prediction is what static friction may hold, and the residual the distance to that." : "";
    const words = band95 + rest;
    put(this.said, `${this.joint}, ${number(from, 4)} s to ${number(to, 4)} s: ${samples} samples, ${all ? "all" : drawn} drawn${all ? "" : " with their extremes"}. ${words}`);
  }
}

/** A grey ground where the joint stands. */
function shade(one, line) {
  if (!line || one.scales.x.min === null || one.scales.x.min === undefined) return;
  const { x, values: { standing } } = line;
  const { left, top, width, height } = one.bbox;
  one.ctx.save();
  one.ctx.fillStyle = colour("standing");
  for (let first = 0; first < x.length; first++) {
    if (standing[first] !== true) continue;
    let last = first;
    while (standing[last + 1] === true) last++;
    const [from, to] = [first, last].map((index) => Math.min(left + width, Math.max(left, one.valToPos(x[index], "x", true))));
    if (to > from) one.ctx.fillRect(from, top, to - from, height);
    first = last;
  }
  one.ctx.restore();
}

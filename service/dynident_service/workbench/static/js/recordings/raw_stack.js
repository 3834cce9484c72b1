// Raw signals of a recording, joint above joint, with standstills and windows.

import { get, lastAsked } from "../api.js";
import { armBeside } from "../arm/arm_beside_figures.js";
import { field, h, put, select } from "../dom.js";
import { grouped, number, quantity } from "../format.js";
import { axis, colour, onColours, timeAxis } from "../plots.js";
import { orSay } from "../problem.js";
import { shadeStretches } from "../signals/plot_backgrounds.js";
import { redraw, timePlot } from "../signals/time_plot.js";
import { TimeView, askedStretch, rememberStretch, timeButtons, timeGroup } from "../signals/time_view.js";

const BUCKETS = 300; // stretches of the screen whose extremes are kept
const HEIGHT = 128;
const MORE = [["dq", "velocity"], ["ddq", "acceleration"], ["q_command", "commanded position"], ["temperature", "temperature"], ["current", "current"]];

export class RawStack {
  constructor(measurement, windows, signal) {
    Object.assign(this, { measurement, windows, signal, plots: [], halts: {} });
    this.joints = measurement.joints;
    this.view = new TimeView();
    this.asking = lastAsked(signal);
    this.said = h("p", { class: "note", id: "zoom-state" });
    this.trouble = h("div");
    this.group = timeGroup(this.view, "Positions and torques of all joints over time.");
    this.arm = armBeside({ robotId: measurement.robot_id, view: this.view, motion: () => this.#motion() }, signal);
    this.more = h("div", { class: "bar-of-fields" });
    this.also = "";
    this.element = h("div", {}, timeButtons(this.view), this.more, this.trouble, this.group, this.said, this.arm.element);
    this.view.addEventListener("stretch", () => this.#move(), { signal });
    this.view.addEventListener("settled", () => this.#settled(), { signal });
    windows.addEventListener("change", () => this.plots.forEach(({ plot }) => plot.redraw(false, true)), { signal });
    onColours(() => this.#draw(), signal);
  }

  /** Read the signals, whole and then what the address says of an interval; and when the joints stand. */
  async show() {
    const wanted = askedStretch();
    put(this.said, "Reading the file …");
    const halts = this.#readHalts();
    await this.#read(null);
    if (wanted) this.view.go(wanted);
    await halts;
  }

  async #readHalts() {
    await orSay(this.trouble, async () => {
      const { joints } = await get(`/measurements/${this.measurement.id}/standstills`, {}, this.signal);
      this.halts = Object.fromEntries(joints.map((one) => [one.joint, one.standing]));
      for (const { plot } of this.plots) plot.redraw(false, true);
    }, this.signal);
  }

  async #read(stretch) {
    const until = this.asking();
    if (!stretch && this.full) return this.#fill(this.full);
    const signals = this.joints.flatMap((joint, index) => [`q_${joint}`, `tau_${joint}`, this.#nameOf(this.also, index)]).filter(Boolean);
    const query = { signals: signals.join(","), points: 2 * BUCKETS * signals.length, ...(stretch ?? {}) };
    return orSay(this.trouble, async () => {
      const found = ordered(await get(`/measurements/${this.measurement.id}/raw`, query, until));
      if (until.aborted) return;
      put(this.trouble);
      if (!stretch) {
        this.full = found;
        this.view.setWhole(found.t[0] ?? 0, found.t.at(-1) ?? 1);
        if (!this.more.childElementCount) this.#offer(found);
      }
      this.#fill(found);
    }, until, () => this.#read(stretch));
  }

  /** Let one kind of signal more be chosen, of those that the file has. */
  #offer({ available }) {
    const has = (kind) => this.joints.some((_, index) => (kind === "current" ? this.#nameOf(kind, index) : available.includes(this.#nameOf(kind, index))));
    const there = MORE.filter(([kind]) => has(kind));
    const show = (kind) => {
      this.also = kind;
      this.full = null;
      for (const { plot, extra } of this.plots.splice(0)) [plot, extra].forEach((one) => one?.destroy());
      this.#read(null).then(() => this.view.stretch && this.#read(this.view.stretch));
    };
    if (there.length) put(this.more, field("Also show", select([["", "nothing more"], ...there], this.also, show, { id: "also-show" })));
  }

  /** What a signal of a joint is asked for by: a current by its column, as it stands in the file. */
  #nameOf(kind, index) {
    if (!kind) return null;
    if (kind !== "current") return `${kind}_${this.joints[index]}`;
    const { columns = {} } = this.measurement.request;
    return columns[`current${index + 1}`] ?? columns[`current_${this.joints[index]}`] ?? null;
  }

  /** Where the joints were, in rad or m. */
  #motion() {
    if (!this.full) return null;
    const { t, signals } = this.full;
    return this.joints.map((joint) => ({ t, q: signals[`q_${joint}`] }));
  }

  #settled() {
    const { stretch } = this.view;
    rememberStretch(stretch);
    this.#read(stretch);
  }

  #fill(found) {
    this.found = found;
    if (!this.plots.length) this.#draw();
    this.#redraw();
    const { from, to } = this.view.range;
    const all = found.t.length === found.n_samples;
    put(this.said, `${number(from, 4)} s to ${number(to, 4)} s: ${grouped(found.n_samples)} samples as recorded, ${all ? "all drawn" : `${grouped(found.t.length)} drawn, with all extremes`}. Standstill is grey.${found.turned ? " Time runs backwards in the file: the runs are drawn in the order of time." : ""}`);
  }

  #move() {
    for (const { plot, extra } of this.plots) [plot, extra].forEach((one) => one && redraw(one, this.view));
  }

  #redraw() {
    for (const { plot, extra, joint, more } of this.plots) {
      redraw(plot, this.view, dataOf(this.found, joint));
      if (extra) redraw(extra, this.view, [this.found.t, this.found.signals[more]]);
    }
  }

  #draw() {
    if (!this.found) return;
    for (const { plot, extra } of this.plots) [plot, extra].forEach((one) => one?.destroy());
    this.plots = this.joints.map((joint, index) => this.#row(joint, index === this.joints.length - 1));
    put(this.group, this.plots.map((one) => one.element));
    this.#redraw();
  }

  #row(joint, last) {
    const { units } = this.found;
    const [q, tau] = [units[`q_${joint}`], units[`tau_${joint}`]];
    const values = h("span", { class: "note" });
    const target = h("div", { class: "chart" });
    const element = h("div", { class: "joint-row", "data-joint": joint }, h("p", { class: "chart-title" }, joint, " ", values), target);
    const line = (label, stroke, scale) => ({ label, stroke, scale, width: 1.2, points: { show: false }, spanGaps: false });
    const x = timeAxis(last ? "time (s)" : "");
    const read = (one) => {
      const at = one.cursor.idx;
      const { t, signals } = this.found;
      if (at === null || at === undefined || one.cursor.left < 0) put(values);
      else put(values, `${number(t[at], 5)} s: position ${quantity(signals[`q_${joint}`][at], q)}, torque ${quantity(signals[`tau_${joint}`][at], tau)}`);
    };
    const ground = (one) => {
      shadeStretches(one, this.halts[joint] ?? [], colour("standing"));
      this.windows.draw(one);
    };
    const scales = { q: {}, tau: {} };
    const left = { ...axis(`position (${q})`, 3), scale: "q", space: 20, stroke: colour("residual") };
    const right = { ...axis(`torque (${tau})`, 1), scale: "tau", space: 20, size: 64, stroke: colour("predicted"), grid: { show: false } };
    const series = [{}, line("position", colour("residual"), "q"), line("torque", colour("predicted"), "tau")];
    const options = { height: HEIGHT + (last ? 46 : 0), series, scales, axes: [x, left, right], legend: { show: false }, hooks: { drawClear: [ground], setCursor: [read] } };
    let taken = () => false;
    const plot = timePlot(target, this.view, { options, data: series.map(() => []), linked: "raw", taken: (event) => taken(event) }, this.signal);
    taken = this.windows.holdIn(plot, this.signal);
    const more = this.#nameOf(this.also, this.joints.indexOf(joint));
    return { joint, element, plot, more, extra: this.found.signals[more] ? this.#extra(element, more) : null };
  }

  /** A figure of one signal more, under those of its joint. */
  #extra(element, name) {
    const target = h("div", { class: "chart", "data-signal": name });
    element.append(target);
    const words = MORE.find(([kind]) => kind === this.also)[1];
    const unit = this.found.units[name] || (this.also === "current" ? (this.measurement.request.units?.current ?? "A") : "");
    const series = [{}, { label: words, stroke: colour("measured"), width: 1.2, points: { show: false }, spanGaps: false }];
    const options = { height: HEIGHT - 40, series, axes: [timeAxis(""), { ...axis(`${words}${unit ? ` (${unit})` : ""}`, 3), space: 20 }], legend: { show: false } };
    return timePlot(target, this.view, { options, data: [[], []], linked: "raw" }, this.signal);
  }
}

function dataOf({ t, signals }, joint) {
  return [t, signals[`q_${joint}`], signals[`tau_${joint}`]];
}

/** Rows in the order of time, those without a time left out: a figure needs both. */
function ordered(found) {
  const rows = found.t.map((_, index) => index).filter((index) => found.t[index] !== null);
  const turned = rows.some((row, index) => index > 0 && found.t[row] < found.t[rows[index - 1]]);
  if (!turned && rows.length === found.t.length) return found;
  if (turned) rows.sort((a, b) => found.t[a] - found.t[b]);
  const pick = (values) => rows.map((row) => values[row]);
  return { ...found, turned, t: pick(found.t), signals: Object.fromEntries(Object.entries(found.signals).map(([name, values]) => [name, pick(values)])) };
}

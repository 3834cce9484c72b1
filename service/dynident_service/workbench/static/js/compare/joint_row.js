// Figures of one joint in a comparison: measured and predicted torque, residual with its band.

import { h, put } from "../dom.js";
import { number, quantity } from "../format.js";
import { axis, colour, edges, symmetric, timeAxis, told } from "../plots.js";
import { redraw, timePlot } from "../signals/time_plot.js";
import { drawLine, shade } from "../signals/plot_backgrounds.js";

const LARGE = { torque: 250, residual: 200 };
const SMALL = 104;
const LINKED = "compare";

export class JointRow {
  constructor(view, joint, { onClick, onChoose }, signal) {
    Object.assign(this, { view, joint, onClick, signal, plots: {}, line: null, raw: null });
    this.values = h("span", { class: "note" });
    this.name = h("button", { type: "button", class: "plain", onclick: () => onChoose(joint) }, joint);
    this.torque = h("div", { class: "chart" });
    this.residual = h("div", { class: "chart" });
    this.element = h("div", { class: "joint-row", "data-joint": joint }, h("p", { class: "chart-title" }, this.name, " ", this.values), this.torque, this.residual);
    view.addEventListener("stretch", () => this.#move(), { signal });
  }

  /** Say how it is shown: { chosen, shows: ["torque", "residual"], last }. */
  shape(shape) {
    if (JSON.stringify(shape) === JSON.stringify(this.shaped)) return;
    this.shaped = shape;
    this.element.hidden = !shape.shows.length;
    this.name.setAttribute("aria-pressed", String(shape.chosen));
    for (const kind of ["torque", "residual"]) {
      const id = shape.chosen ? `${kind}-chart` : "";
      if (id) this[kind].id = id;
      else this[kind].removeAttribute("id");
      // Its room is kept until its signals come: what is beneath stays where a hand may already be.
      this[kind].style.minHeight = shape.shows.includes(kind) ? `${this.#height(kind)}px` : "";
    }
    this.draw();
  }

  /** Show signals; `raw` is the torque as it was recorded, { t, values }, where it is wanted. */
  show(line, raw = this.raw) {
    const anew = !this.line || this.line.unit !== line.unit || this.line.shifted !== line.shifted;
    Object.assign(this, { line, raw });
    if (anew || !Object.keys(this.plots).length) this.draw();
    else this.#fill();
  }

  /** Draw the figures anew: another height, other colours. */
  draw() {
    for (const one of Object.values(this.plots)) one.destroy();
    this.plots = {};
    if (!this.line || !this.shaped) return;
    const { chosen, shows } = this.shaped;
    const { unit, shifted } = this.line;
    const time = shifted ? "time, runs one after another (s)" : "time (s)";
    const value = told((raw) => `${number(raw)} ${unit}`);
    const line = (label, stroke, width = 1) => ({ label, stroke, width, points: { show: false }, value });
    const first = { label: "time", value: told((raw) => `${number(raw, 5)} s`) };
    const wash = { series: [1, 2], fill: colour("band-wash") };
    const rest = { series: [3, 4], fill: colour("rest-wash") };
    const kinds = {
      torque: [[first, ...edges(["95 % upper", "lower", "static friction, upper", "static friction, lower"], value), line("measured", colour("measured"), 1.6), line("predicted", colour("predicted"), 1.2)], [wash, rest], (one, low, high) => this.#around(one, low, high)],
      residual: [[first, ...edges(["95 % upper", "lower"], value), line("residual", colour("residual"), 1)], [wash], symmetric],
    };
    shows.forEach((kind) => {
      const [series, bands, range] = kinds[kind];
      const x = timeAxis(this.#saysTime(kind) ? time : "");
      const options = {
        height: this.#height(kind),
        series,
        bands,
        scales: { y: { range } },
        axes: [x, { ...axis(`${kind} (${unit})`, 3), space: chosen ? 30 : 20 }],
        legend: { show: chosen, live: true },
        hooks: { drawClear: [(one) => this.#ground(one, kind)], setCursor: [(one) => this.#read(one, kind)] },
      };
      this.plots[kind] = timePlot(this[kind], this.view, { options, data: series.map(() => []), linked: LINKED, onClick: (time) => this.onClick(this.joint, time) }, this.signal);
    });
    this.#fill();
  }

  #saysTime(kind) {
    const { chosen, shows, last } = this.shaped;
    return chosen || (last && kind === shows.at(-1));
  }

  #height(kind) {
    return this.shaped.chosen ? LARGE[kind] : SMALL + (this.#saysTime(kind) ? 46 : 0);
  }

  #fill() {
    const { x, values } = this.line;
    const { measured, predicted, lower, upper, standing, residual, band } = values;
    const plus = (centre, sign) => band.map((half, index) => (half === null ? null : (centre ? centre[index] : 0) + sign * half));
    const where = (rests, signal) => (standing ? signal.map((value, index) => (standing[index] === rests ? value : null)) : rests ? signal.map(() => null) : signal);
    const none = predicted.map(() => null);
    // At rest the prediction has no sign of friction: what friction may hold stands in its place.
    const held = standing ? [where(true, upper), where(true, lower)] : [none, none];
    const data = {
      torque: () => [x, where(false, plus(predicted, 1)), where(false, plus(predicted, -1)), ...held, measured, where(false, predicted)],
      residual: () => [x, plus(null, 1), plus(null, -1), residual],
    };
    for (const [kind, one] of Object.entries(this.plots)) redraw(one, this.view, data[kind]());
  }

  #move() {
    for (const one of Object.values(this.plots)) redraw(one, this.view);
  }

  #ground(one, kind) {
    if (!this.line) return;
    shade(one, this.line.x, this.line.values.standing ?? []);
    if (kind === "torque" && this.raw) drawLine(one, this.raw, colour("soft"));
  }

  /** Room for what is drawn, and for the torque as it was recorded where that is shown. */
  #around(one, low, high) {
    let [least, most] = [low ?? 0, high ?? 1];
    const { from, to } = this.view.range;
    for (const [index, t] of (this.raw?.t ?? []).entries()) {
      const value = this.raw.values[index];
      if (t < from || t > to || value === null) continue;
      least = Math.min(least, value);
      most = Math.max(most, value);
    }
    const room = 0.06 * (most - least || 1);
    return [least - room, most + room];
  }

  #read(one, kind) {
    if (kind !== this.shaped.shows[0]) return;
    const index = one.cursor.idx;
    const { values, x, unit } = this.line;
    if (index === null || index === undefined || one.cursor.left < 0 || values.measured[index] === null) {
      put(this.values);
      return;
    }
    const { measured, predicted, residual } = values;
    put(this.values, `${number(x[index], 5)} s: measured ${quantity(measured[index], unit)}, predicted ${quantity(predicted[index], unit)}, residual ${quantity(residual[index], unit)}`);
  }
}

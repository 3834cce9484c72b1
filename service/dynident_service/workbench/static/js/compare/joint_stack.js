// All joints of a comparison above one another, with one time axis and cursor.

import { armBeside } from "../arm/arm_beside_figures.js";
import { announce, field, h, put, select } from "../dom.js";
import { number, percent } from "../format.js";
import { onColours } from "../plots.js";
import { orSay } from "../problem.js";
import { TimeView, askedStretch, rememberStretch, timeButtons, timeGroup } from "../signals/time_view.js";
import { find } from "../timeline.js";
import { JointRow } from "./joint_row.js";
import { Moment, around } from "./failing_interval.js";
import { rawReader, whyNoRaw } from "./raw_torque.js";
import { Reader } from "./signal_reader.js";

const OTHERS = [["torque", "measured and predicted"], ["residual", "residual"], ["both", "both"], ["", "not shown"]];

export class CompareStack {
  constructor(model, signal) {
    Object.assign(this, { model, signal, lines: {}, raw: {}, others: "torque" });
    this.view = new TimeView();
    this.trouble = h("div");
    this.said = h("p", { class: "note", id: "zoom-state" });
    this.rawSaid = h("small", { class: "note" });
    this.wantsRaw = h("input", { type: "checkbox", id: "raw-torque", onchange: () => this.#readRaw() });
    this.moment = new Moment(model, signal);
    const step = (by) => () => model.chooseJoint(model.limb.at((model.limb.indexOf(model.joint) + by) % model.limb.length));
    const keys = { ArrowUp: step(-1), ArrowDown: step(1), Enter: () => this.#click(model.joint, (this.view.range.from + this.view.range.to) / 2, 0.5) };
    const onChoose = (joint) => model.chooseJoint(joint);
    const onClick = (joint, time) => this.#click(joint, time);
    this.rows = Object.fromEntries(model.joints.map((joint) => [joint, new JointRow(this.view, joint, { onClick, onChoose }, signal)]));
    const group = timeGroup(this.view, "Torque and residual of all joints over time. Up and down choose a joint, Enter examines the time that is shown.", keys);
    group.append(...Object.values(this.rows).map((one) => one.element));
    this.arm = armBeside({ robotId: model.robot.id, view: this.view, motion: () => this.#motion() }, signal);
    this.element = h("div", {}, timeButtons(this.view), this.#choices(), this.trouble, group, this.said, this.moment.element, this.arm.element);
    this.view.addEventListener("settled", () => this.#settled(), { signal });
    onColours(() => Object.values(this.rows).forEach((one) => one.draw()), signal);
  }

  /** Show a comparison; what the address says of an interval stays. Gives when the chosen joint is there, and when all are. */
  show(comparison) {
    const chosen = new Promise((resolve) => { this.chosenShown = resolve; });
    const all = this.#showAll(comparison);
    return { chosen: Promise.race([chosen, all]), all };
  }

  async #showAll(comparison) {
    this.reader = new Reader(comparison, this.model.joints, (joint, line) => this.#show(joint, line), this.signal);
    Object.assign(this, { lines: {}, raw: {} });
    this.moment.clear();
    this.shape();
    this.view.stretch = null;
    this.view.setWhole(comparison.result.start_time, comparison.result.end_time);
    const wanted = askedStretch();
    // What the address asks for comes first; only of runs one after another all has to be known before.
    const known = wanted && !overlap(this.model.measurements.find((one) => one.id === this.model.measurement).segments);
    if (!known && !(await this.#read(null))) return;
    this.arm.forget();
    if (wanted) this.view.go(wanted);
    else this.#readRaw();
  }

  /** Follow the chosen joint. */
  shape() {
    const { joint, joints, limb } = this.model;
    const kinds = { torque: ["torque"], residual: ["residual"], both: ["torque", "residual"], "": [] }[this.others];
    joints.forEach((one) => {
      const chosen = one === joint;
      this.rows[one].shape({ chosen, shows: chosen ? ["torque", "residual"] : kinds, last: one === limb.at(-1) });
    });
    this.#tell();
  }

  /** Zoom to an interval of the recording's time on a joint, and say what was there. */
  zoom(joint, { from, to }) {
    const full = this.reader?.full[joint];
    const place = full?.shifted ? find(full, from, to, full.values.residual) : { from, to };
    if (!place) return;
    const room = 0.25 * (to - from);
    this.looksAt = [joint, place];
    this.view.go({ from: place.from - room, to: place.to + room });
  }

  #choices() {
    const why = whyNoRaw(this.model.robot);
    this.wantsRaw.disabled = Boolean(why);
    put(this.rawSaid, why);
    const others = this.model.joints.length > 1 && field("Other joints", select(OTHERS, this.others, (value) => {
      this.others = value;
      this.shape();
    }));
    return h("div", { class: "bar-of-fields" }, others, h("label", { class: "pick-one" }, this.wantsRaw, " torque as recorded, before the filters"), this.rawSaid);
  }

  #show(joint, line) {
    this.lines[joint] = line;
    if (line.shifted) this.view.setWhole(line.x[0], line.x.at(-1));
    this.rows[joint].show(line, this.raw[joint] ?? null);
    if (joint !== this.model.joint) return;
    this.#tell();
    this.chosenShown();
  }

  async #read(stretch) {
    return orSay(this.trouble, async () => {
      await this.reader.read(stretch, this.model.joint);
      put(this.trouble);
      return true;
    }, this.signal, () => this.#read(stretch));
  }

  /** Where the joints were; null as long as that is not known of all. */
  #motion() {
    const lines = this.model.joints.map((joint) => this.reader?.full[joint] ?? this.lines[joint]);
    return lines.every((one) => one?.values.q) ? lines.map(({ x, values }) => ({ t: x, q: values.q })) : null;
  }

  async #settled() {
    const { stretch } = this.view;
    rememberStretch(stretch);
    this.#readRaw();
    if (!(await this.#read(stretch)) || stretch !== this.view.stretch) return;
    if (this.looksAt) this.#look(...this.looksAt, this.lines);
    this.looksAt = null;
    this.reader.fill().catch(() => {}); // Asked for again, and complained of, when it is to be shown.
  }

  async #readRaw() {
    const wanted = this.wantsRaw.checked && !this.wantsRaw.disabled;
    if (wanted && this.reader?.shifted) {
      put(this.rawSaid, "Runs that overlap in time are drawn one after another here; the page of the recording shows the recording itself.");
      return;
    }
    try {
      this.reading ??= rawReader(this.model, this.signal);
      if (wanted) put(this.rawSaid, "reading …");
      this.raw = wanted ? await this.reading(this.view.stretch) : {};
      put(this.rawSaid, wanted ? "" : whyNoRaw(this.model.robot));
      for (const [joint, line] of Object.entries(this.lines)) this.rows[joint].show(line, this.raw[joint] ?? null);
    } catch (error) {
      if (error.name !== "AbortError") put(this.rawSaid, `The recorded torque cannot be read: ${error.message}`);
    }
  }

  #click(joint, time, share = null) {
    this.model.chooseJoint(joint);
    const { from, to } = this.view.range;
    this.#look(joint, share ? { from, to } : around(time, this.view), this.lines);
  }

  /** Say what was in an interval, right beneath the joint. */
  #look(joint, stretch, lines) {
    this.rows[joint].element.after(this.moment.element);
    this.moment.show(joint, stretch, lines);
    this.moment.element.scrollIntoView({ block: "nearest" });
  }

  #tell() {
    const { joint } = this.model;
    const line = this.lines[joint];
    if (!line) return;
    const { residual, standing, band } = line.values;
    // Of the interval that was counted: what is on the screen may have moved on while the next is read.
    const { from, to } = line.stretch ?? this.view.whole;
    const isMoving = (index) => residual[index] !== null && standing?.[index] !== true;
    const moving = residual.map((_, index) => index).filter(isMoving);
    const outside = moving.filter((index) => Math.abs(residual[index]) > band[index]).length;
    const drawn = residual.filter((value) => value !== null).length;
    const all = drawn === line.samples;
    const band95 = all && moving.length ? `${percent(outside / moving.length, 2)} of the residual is outside its 95 % band; noise alone leaves 5 % there.` : "Noise alone leaves 5 % of the residual outside its 95 % band.";
    const rest = standing?.includes(true) ? " Where the background is grey, the joint stands still: there the prediction is the range of static friction, and the residual is the distance to this range." : "";
    put(this.said, `${joint}, ${number(from, 4)} s to ${number(to, 4)} s: ${line.samples} samples, ${all ? "all" : drawn} drawn${all ? "" : " with their extremes"}. ${band95}${rest}`);
  }

  /** Say to those who do not see it which interval is shown. */
  announce(joint, { from, to }) {
    announce(`${joint}, ${number(from)} to ${number(to)} s`);
  }
}

function overlap(segments) {
  return segments.some((one, index) => index > 0 && one.start_time <= segments[index - 1].end_time);
}

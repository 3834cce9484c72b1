// What a file seems to be, with reasons: unit and torque kind can be corrected.

import { h, put, select } from "../dom.js";
import { percent } from "../format.js";
import { inPageWords } from "./remedies.js";
import { signalInWords } from "./revision_edits.js";

const SURE = 0.7;
const SI = "si";
const UNITS = {
  t: ["s", "ms", "us", "ns", "100ns"],
  q: ["SI: rad or m", "deg", "mrad", "rev", "mm", "cm"],
  q_command: ["SI: rad or m", "deg", "mrad", "rev", "mm", "cm"],
  dq: ["SI: rad/s or m/s", "deg/s", "rpm", "mm/s"],
  ddq: ["SI: rad/s² or m/s²", "deg/s^2", "mm/s^2"],
  tau: ["SI: N m or N", "mN m", "kN m", "N mm", "N cm", "mN", "kN"],
  current: ["A", "mA"],
  temperature: ["degC", "K", "degF"],
  base_force: ["N", "mN", "kN"],
  base_moment: ["N m", "mN m", "kN m", "N mm", "N cm"],
};
const SI_UNITS = new Set(["s", "rad", "m", "rad/s", "m/s", "rad/s^2", "m/s^2", "N m", "N", "A", "degC"]);

/** The guesses of a file as a list with its drop-downs, `efforts` what a torque may be. Fires "change". */
export class Guesses extends EventTarget {
  constructor(efforts) {
    super();
    this.efforts = efforts;
    this.element = h("div");
    this.unitsByHand = {};
    this.effortByHand = null;
  }

  /** Units by kind of signal or by column, as an upload takes them. */
  get units() {
    const all = { ...this.proposed.units, ...this.unitsByHand };
    return Object.fromEntries(Object.entries(all).filter(([key, unit]) => unit && unit !== SI && this.#isThere(key)));
  }

  get effort() {
    return this.effortByHand ?? this.proposed.effort_kind;
  }

  /** Fill it with what was found in a file, for the kinds of signals that its columns are said to be. */
  fill(found, kinds, joints) {
    Object.assign(this, { found, proposed: found.proposed, joints });
    this.follow(kinds);
  }

  /** Other kinds of signals are there now. */
  follow(kinds) {
    this.kinds = kinds;
    const { guesses, questions } = this.found;
    const about = (field) => guesses.find((one) => one.field === field);
    const asked = (field) => questions.find((one) => one.field === field);
    const named = [["columns/t", "Time"], ["columns/q", "Positions"], ["columns/tau", "Torques"], ["columns/current", "Currents"], ["columns/q_command", "Commands"], ["columns/dq", "Velocities"]];
    const keys = [...new Set([...Object.keys(UNITS).filter((key) => this.#isThere(key)), ...Object.keys(this.proposed.units).filter((key) => this.#isThere(key))])];
    const rows = [
      ...named.filter(([field]) => about(field)).map(([field, name]) => [name, about(field).value, about(field)]),
      ...keys.map((key) => [`Unit of ${key === "t" ? "time" : signalInWords(key, this.joints)}`, this.#unitPicker(key, asked(`units/${key}`), about(`units/${key}`)), about(`units/${key}`), asked(`units/${key}`)]),
      ["What the torque is", this.#effortPicker(asked("effort_kind")), about("effort_kind"), asked("effort_kind")],
      ...(about("check") ? [["Does it fit the robot?", about("check").value, about("check")]] : []),
    ];
    const others = questions.filter((one) => !rows.some(([, , , question]) => question === one));
    put(
      this.element,
      others.map((one) => h("p", { class: "box warning", "data-question": one.field }, inPageWords(one.detail, one.remedies, this.joints), one.choices?.length ? h("small", {}, ` (${one.choices.slice(0, 12).join(", ")})`) : null)),
      h("dl", { class: "facts guesses" }, rows.map(([name, value, guess, question]) => [h("dt", {}, name), h("dd", {}, value, " ", reasonOf(guess, question))])),
    );
  }

  #isThere(key) {
    const kind = key.replace(/\d+$|_(?!command|force|moment).*$/, "");
    const wrench = { base_force: "base", base_moment: "base" }[kind];
    return this.kinds?.has(wrench ?? kind) ?? true;
  }

  #unitPicker(key, question, guess) {
    const kind = Object.keys(UNITS).find((one) => one === key) ?? key.replace(/\d+$|_(?!command).*$/, "");
    const [si, ...others] = UNITS[kind] ?? ["SI"];
    const proposed = this.proposed.units[key] ?? (guess && !SI_UNITS.has(guess.value) ? guess.value : SI);
    const chosen = this.unitsByHand[key] ?? (question ? "" : SI_UNITS.has(proposed) ? SI : proposed);
    const options = [[SI, si], ...[...new Set([...others, ...(question?.choices ?? []), chosen])].filter((unit) => unit && unit !== SI && !SI_UNITS.has(unit)).map((unit) => [unit, unit])];
    const more = question || chosen === "" ? [["", "choose …"], ...options] : options;
    const picker = select(more, chosen, (unit) => {
      this.unitsByHand[key] = unit;
      this.dispatchEvent(new Event("change"));
    }, { "data-unit-of": key, "aria-label": `Unit of ${key}`, required: Boolean(question) });
    return h("span", { "data-pointer": `/metadata/units/${key}` }, picker);
  }

  #effortPicker(question) {
    const chosen = this.effortByHand ?? (question?.choices?.length ? "" : this.proposed.effort_kind);
    const options = question?.choices?.length ? [["", "choose …"], ...this.efforts.filter(([kind]) => kind !== "unknown")] : this.efforts;
    const picker = select(options, chosen, (kind) => {
      this.effortByHand = kind;
      this.dispatchEvent(new CustomEvent("effort", { detail: kind }));
      this.dispatchEvent(new Event("change"));
    }, { name: "effort", "aria-label": "What the torque is", required: Boolean(question?.choices?.length) });
    return h("span", { "data-pointer": "/metadata/effort_kind" }, picker);
  }
}

function reasonOf(guess, question) {
  if (question) return h("span", { class: "mark warning" }, inPageWords(question.detail, question.remedies));
  if (!guess) return null;
  const sure = guess.confidence >= SURE;
  const looks = guess.field.startsWith("units/") ? `looks like ${guess.value}: ` : "";
  return h("span", { class: sure ? "note" : "mark warning" }, `${looks}${inPageWords(guess.reason, guess.remedies)} (${percent(guess.confidence, 2)} sure)`);
}

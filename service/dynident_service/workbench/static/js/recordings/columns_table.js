// Table of a file's first rows with a choice of what each column is.

import { h, put, row, svg, table } from "../dom.js";
import { counted, number } from "../format.js";
import { signalInWords } from "./revision_edits.js";

const SHOWN = 3; // values of each column
const [WIDTH, HEIGHT] = [110, 22]; // px of a small drawing
const KINDS = ["q", "tau", "current", "dq", "q_command", "ddq", "temperature"];
const WRENCH = ["base_fx", "base_fy", "base_fz", "base_mx", "base_my", "base_mz"];

/** A choice of what every column is. Fires "change"; keeps what was chosen by hand when it is guessed anew. */
export class ColumnsTable extends EventTarget {
  constructor() {
    super();
    this.element = h("div", { "data-pointer": "/metadata/columns" });
    this.ours = new Map(); // the file's column -> our name for it
    this.chosen = new Map(); // the same, of those that were chosen by hand; "" where one is not to be used
  }

  /** Our names to the file's, as an upload takes them. */
  get columns() {
    return Object.fromEntries([...this.ours].filter(([, ours]) => ours).map(([theirs, ours]) => [ours, theirs]));
  }

  /** What was chosen by hand, in the same form. */
  get byHand() {
    return Object.fromEntries([...this.chosen].filter(([, ours]) => ours).map(([theirs, ours]) => [ours, theirs]));
  }

  /** How many columns there are and how many are used. */
  get inWords() {
    const used = [...this.ours.values()].filter(Boolean).length;
    return `${counted(this.ours.size, "column")} of the file, ${used} used`;
  }

  /** Kinds of signals that there are: "q", "tau", … */
  get kinds() {
    return new Set([...this.ours.values()].filter(Boolean).map((ours) => ours.replace(/\d+$|_(?!command).*$/, "")));
  }

  /** Fill it with what was guessed for the joints of a robot. */
  fill({ preview, proposed }, joints) {
    this.preview = preview;
    this.joints = joints;
    const guessed = new Map(Object.entries(proposed.columns).map(([ours, theirs]) => [theirs, ours]));
    const taken = new Set(Object.keys(this.byHand));
    this.ours = new Map(preview.columns.map((theirs) => {
      if (this.chosen.has(theirs)) return [theirs, this.chosen.get(theirs)];
      const ours = guessed.get(theirs) ?? "";
      return [theirs, taken.has(ours) ? "" : ours];
    }));
    this.#draw();
  }

  /** Torques are currents after all, or the other way round. */
  rename(from, to) {
    for (const [theirs, ours] of this.ours) {
      if (new RegExp(`^${from}(\\d|_)`).test(ours)) this.#set(theirs, ours.replace(from, to));
    }
    this.#draw();
    this.dispatchEvent(new Event("change"));
  }

  #choose(theirs, ours) {
    const before = this.ours.get(theirs);
    const other = ours && [...this.ours].find(([name, one]) => one === ours && name !== theirs);
    // Two columns cannot be the same signal: they change places.
    if (other) this.#set(other[0], before);
    this.#set(theirs, ours);
    if (other) this.#draw(theirs);
    this.dispatchEvent(new Event("change"));
  }

  #set(theirs, ours) {
    this.ours.set(theirs, ours);
    this.chosen.set(theirs, ours);
  }

  #draw(focused = null) {
    const { columns, rows } = this.preview;
    const values = (index) => rows.slice(0, SHOWN).map((one) => ({ class: "n", text: one[index] === null ? "–" : number(one[index], 5) }));
    const lines = columns.map((theirs, index) => row([theirs, this.#picker(theirs), sparkline(this.preview.sketch.map((one) => one[index])), ...values(index)], { class: this.ours.get(theirs) ? "pick" : null }));
    const head = ["column of the file", "is", "over time", ...rows.slice(0, SHOWN).map((_, index) => ({ text: `row ${index + 1}`, class: "n" }))];
    put(this.element, table("What the columns are", head, lines, { class: "columns" }));
    if (focused !== null) [...this.element.querySelectorAll("select")].find((one) => one.dataset.column === focused)?.focus();
  }

  #picker(theirs) {
    const ours = this.ours.get(theirs);
    const option = (value, text = signalInWords(value, this.joints)) => h("option", { value, selected: value === ours }, text);
    const groups = this.joints.map((joint, index) => h("optgroup", { label: joint }, KINDS.map((kind) => option(`${kind}${index + 1}`))));
    const known = new Set(["", "t", "segment", ...WRENCH, ...this.joints.flatMap((_, index) => KINDS.map((kind) => `${kind}${index + 1}`))]);
    return h("select", { "data-column": theirs, "aria-label": `What ${theirs} is`, onchange: (event) => this.#choose(theirs, event.target.value) },
      option("", "not used"),
      option("t", "time"),
      known.has(ours) ? null : option(ours),
      groups,
      h("optgroup", { label: "of the whole robot" }, option("segment", "number of the run"), WRENCH.map((one) => option(one, `${one.replace("base_", "")} on the base`))),
    );
  }
}

/** A small drawing of a column's values over time. */
function sparkline(values) {
  const there = values.filter((one) => one !== null);
  const [low, high] = [Math.min(...there), Math.max(...there)];
  if (!there.length) return "";
  const x = (index) => ((WIDTH - 2) * index) / Math.max(1, values.length - 1) + 1;
  const y = (value) => (high > low ? HEIGHT - 2 - ((HEIGHT - 4) * (value - low)) / (high - low) : HEIGHT / 2);
  const points = values.map((one, index) => (one === null ? "" : `${x(index).toFixed(1)},${y(one).toFixed(1)}`)).filter(Boolean).join(" ");
  return svg("svg", { class: "sparkline", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, role: "img", "aria-label": `from ${number(low)} to ${number(high)}` }, svg("polyline", { points }));
}

// Windows of a recording that are used or left out: dragged in a figure, or typed.

import { h, put, row, select, table } from "../dom.js";
import { colour } from "../plots.js";
import { timeAt, whileHeld } from "../signals/time_plot.js";
import { shadeStretches } from "../signals/plot_backgrounds.js";
import { stretchesInWords } from "./revision_edits.js";

const REACH = { mouse: 7, touch: 20 }; // px from an end at which it is taken hold of
const DIGITS = 3;

/** Fires "change" whenever an interval is another one. */
export class Windows extends EventTarget {
  constructor({ windows, exclude }, whole) {
    super();
    this.whole = whole;
    this.stored = JSON.stringify({ windows, exclude });
    this.reset();
  }

  /** What a revision is to say; null where nothing has changed. */
  get edit() {
    const now = { windows: this.windows, exclude: this.exclude };
    const before = JSON.parse(this.stored);
    const changed = Object.keys(now).filter((name) => JSON.stringify(now[name]) !== JSON.stringify(before[name]));
    return changed.length ? Object.fromEntries(changed.map((name) => [name, now[name]])) : null;
  }

  reset() {
    Object.assign(this, JSON.parse(this.stored));
    this.#tell();
  }

  add(kind, from, to) {
    this[kind] = sorted([...this[kind], [rounded(from), rounded(to)]]);
    this.#tell();
  }

  /** Another kind, or other ends, for an interval. */
  replace(kind, index, [from, to], newKind = kind) {
    const kept = this[kind].filter((_, place) => place !== index);
    this[kind] = kept;
    this[newKind] = sorted([...this[newKind], [from, to]]);
    this.#tell();
  }

  drop(kind, index) {
    this[kind] = this[kind].filter((_, place) => place !== index);
    this.#tell();
  }

  /** Grounds over what is not used, and lines at the ends; for the hook "drawClear" of a figure. */
  draw(one) {
    const { from, to } = this.whole;
    const used = this.windows.length ? this.windows : [[from, to]];
    const outside = [];
    let at = from;
    for (const [first, last] of used) {
      if (first > at) outside.push([at, first]);
      at = Math.max(at, last);
    }
    if (at < to) outside.push([at, to]);
    shadeStretches(one, outside, colour("unused"));
    shadeStretches(one, this.exclude, colour("left-out"));
    const half = (one.scales.x.max - one.scales.x.min) / one.bbox.width;
    shadeStretches(one, this.#ends().map(({ time }) => [time - 1.5 * half, time + 1.5 * half]), colour("main"));
  }

  /** Let the ends be dragged in a figure. Gives whether a press at a place takes hold of one. */
  holdIn(one, signal) {
    const near = (event) => {
      const place = event.clientX - one.over.getBoundingClientRect().left;
      const [best] = this.#ends().map((end) => ({ ...end, far: Math.abs(one.valToPos(end.time, "x") - place) })).sort((a, b) => a.far - b.far);
      return best && best.far <= (REACH[event.pointerType] ?? REACH.mouse) ? best : null;
    };
    one.over.addEventListener("mousemove", (event) => one.over.style.setProperty("cursor", near(event) ? "ew-resize" : ""), { signal });
    one.over.addEventListener("pointerdown", (event) => {
      const held = event.button === 0 && near(event);
      if (!held) return;
      let end = held;
      whileHeld((moved) => { end = this.#move(end, timeAt(one, moved)); });
    }, { signal });
    return (event) => Boolean(near(event));
  }

  #ends() {
    const { from, to } = this.whole;
    const of = (kind, all) => all.flatMap((ends, index) => [0, 1].map((side) => ({ kind, index, side, time: ends[side] })));
    return [...of("windows", this.windows.length ? this.windows : [[from, to]]), ...of("exclude", this.exclude)];
  }

  #move(end, time) {
    const { from, to } = this.whole;
    const all = this[end.kind].length ? this[end.kind].map((one) => [...one]) : [[from, to]];
    const other = all[end.index][1 - end.side];
    const shortest = 2 * 10 ** -DIGITS;
    const moved = rounded(Math.min(to, Math.max(from, end.side ? Math.max(time, other + shortest) : Math.min(time, other - shortest))));
    all[end.index][end.side] = moved;
    this[end.kind] = all;
    this.#tell();
    return { ...end, time: moved };
  }

  #tell() {
    this.dispatchEvent(new Event("change"));
  }
}

/** The intervals as a table whose numbers can be typed; it follows them. */
export function windowsTable(windows, signal) {
  const target = h("div");
  const draw = () => {
    // Who types in it is not interrupted.
    if (target.contains(document.activeElement) && document.activeElement.matches("input")) return;
    const all = ["windows", "exclude"].flatMap((kind) => windows[kind].map((ends, index) => rowOf(windows, kind, index, ends)));
    put(target, all.length ? table("Intervals of time", ["what", "from (s)", "to (s)", ""], all, { class: "narrow", id: "windows" }) : h("p", { class: "note" }, "The whole recording is used. Drag an end in the figure, or add an interval."));
  };
  windows.addEventListener("change", draw, { signal });
  draw();
  return target;
}

function rowOf(windows, kind, index, ends) {
  const kinds = select([["windows", "use"], ["exclude", "leave out"]], kind, (value) => windows.replace(kind, index, windows[kind][index], value), { "aria-label": `What to do with ${stretchesInWords([ends])}` });
  const input = (side) => h("input", { type: "number", step: "any", class: "time", value: ends[side], "aria-label": `${side ? "End" : "Beginning"} in s`, onchange: (event) => {
    const changed = [...windows[kind][index]];
    changed[side] = Number(event.target.value);
    event.target.blur();
    windows.replace(kind, index, changed);
  } });
  return row([kinds, input(0), input(1), h("button", { type: "button", class: "small", onclick: () => windows.drop(kind, index) }, "Remove")]);
}

function sorted(all) {
  return [...all].sort((a, b) => a[0] - b[0]);
}

function rounded(time) {
  return Number(time.toFixed(DIGITS));
}

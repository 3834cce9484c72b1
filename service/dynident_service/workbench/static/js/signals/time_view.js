// The interval of time that linked figures show, and its control by buttons, keys, wheel, dragging.

import { h } from "../dom.js";
import { asked, remember } from "../page_address.js";

const SHORTEST = 1e-3;
const SETTLED = 120;

/**
 * Fires "interval" when another interval is to be drawn, at most once a frame, "settled" once it stays, and "cursor" when
 * a person points at another moment (`at`, s).
 */
export class TimeView extends EventTarget {
  constructor() {
    super();
    this.whole = { from: 0, to: 1 };
    this.stretch = null;
  }

  /** What is shown: { from, to } in s. */
  get range() {
    return this.stretch ?? this.whole;
  }

  /** All there is; an interval that is shown already stays. */
  setWhole(from, to) {
    this.whole = { from, to: to > from ? to : from + SHORTEST };
    this.stretch = this.#inside(this.stretch);
  }

  /** Point at a moment. */
  point(time) {
    if (time === this.at) return;
    this.at = time;
    this.pointing ??= requestAnimationFrame(() => {
      this.pointing = null;
      this.dispatchEvent(new Event("cursor"));
    });
  }

  /** Show an interval; null: all. */
  go(stretch) {
    this.stretch = this.#inside(stretch);
    this.#changed();
  }

  /** Show so many times as much, with the moment `about` where it is. */
  scale(factor, about = (this.range.from + this.range.to) / 2) {
    const { from, to } = this.range;
    this.go({ from: about - (about - from) * factor, to: about + (to - about) * factor });
  }

  /** Move on by a share of what is shown. */
  pan(share) {
    const { from, to } = this.range;
    const length = to - from;
    const first = Math.min(Math.max(from + share * length, this.whole.from), this.whole.to - length);
    this.go({ from: first, to: first + length });
  }

  #inside(stretch) {
    if (!stretch) return null;
    const { from: first, to: last } = this.whole;
    const from = Math.max(first, Math.min(stretch.from, last - SHORTEST));
    const to = Math.min(last, Math.max(stretch.to, from + SHORTEST));
    return to - from > 0.999 * (last - first) ? null : { from, to };
  }

  #changed() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.dispatchEvent(new Event("stretch"));
    });
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.dispatchEvent(new Event("settled")), SETTLED);
  }
}

/** The interval that the address asks for; null where it asks for none. */
export function askedStretch() {
  const [from, to] = [asked().from, asked().to];
  return from && to && Number(to) > Number(from) ? { from: Number(from), to: Number(to) } : null;
}

/** Have the address ask for an interval. */
export function rememberStretch(stretch) {
  const seconds = (value) => String(Number(value.toFixed(4)));
  remember({ from: stretch ? seconds(stretch.from) : "", to: stretch ? seconds(stretch.to) : "" });
}

/** Buttons for those who have no wheel. */
export function timeButtons(view) {
  const button = (text, act) => h("button", { type: "button", class: "small", onclick: act }, text);
  return h("p", { class: "actions" },
    button("Whole recording", () => view.go(null)),
    button("Zoom in", () => view.scale(0.5)),
    button("Zoom out", () => view.scale(2)),
    button("← Earlier", () => view.pan(-0.5)),
    button("Later →", () => view.pan(0.5)),
    h("span", { class: "note" }, "or use the mouse wheel, or drag over an interval; with Shift, both move the view; a double click shows all"),
  );
}

/** A group of figures that listens to keys; other keys are offered to `more`. */
export function timeGroup(view, label, more = {}) {
  const keys = {
    ArrowLeft: () => view.pan(-0.25),
    ArrowRight: () => view.pan(0.25),
    "+": () => view.scale(0.5),
    "-": () => view.scale(2),
    Escape: () => view.go(null),
    ...more,
  };
  const onkeydown = (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.target.closest("input, select, button")) return;
    event.preventDefault();
    act();
  };
  const help = "Arrow keys move, plus and minus zoom, Escape shows all.";
  return h("div", { class: "charts", tabindex: "0", role: "group", "aria-label": `${label} ${help}`, onkeydown });
}

// A figure over time, linked with others by one interval and cursor.

import { plot } from "../plots.js";

const STILL = { left: 0, top: 0, width: 0, height: 0 };
const CLICK = 4; // px that the hand may move between pressing and letting go
const NOTCH = 100; // what one notch of a wheel tells
const BY_A_NOTCH = 1.25;

/**
 * A uPlot over the time of `view`. `options` are uPlot's; `linked` names the figures that share a cursor; `onClick` is
 * told the time of a click that is no drag, `taken` whether a press at a place is somebody else's.
 */
export function timePlot(target, view, { options, data, linked, onClick = null, taken = () => false }, signal) {
  let pressed = 0;
  const cursor = {
    sync: { key: linked, setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
    drag: { x: true, y: false, setScale: false },
    y: false,
    points: { size: 6 },
    bind: {
      dblclick: () => () => view.go(null),
      mousedown: (_, __, press) => (event) => {
        pressed = event.clientX;
        if (taken(event)) return;
        if (event.shiftKey) drag(event, made, view);
        else press(event);
      },
    },
  };
  const selected = (one) => {
    const { left, width } = one.select;
    if (width < CLICK) return;
    const [from, to] = [one.posToVal(left, "x"), one.posToVal(left + width, "x")];
    one.setSelect(STILL, false);
    view.go({ from, to });
  };
  const pointed = ({ cursor: { idx, left }, data: [times] }) => left >= 0 && idx !== null && idx !== undefined && view.point(times[idx]);
  const hooks = { ...options.hooks, setSelect: [selected], setCursor: [...(options.hooks?.setCursor ?? []), pointed] };
  const scales = { ...options.scales, x: { time: false, range: () => [view.range.from, view.range.to] } };
  const made = plot(target, { ...options, cursor, hooks, scales }, data, signal);
  made.over.addEventListener("click", (event) => {
    if (Math.abs(event.clientX - pressed) < CLICK && !taken(event)) onClick?.(timeAt(made, event));
  });
  // A finger moves along; up and down it scrolls the page (see touch-action in signals.css).
  made.over.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "touch" && view.stretch && !taken(event)) drag(event, made, view);
  });
  made.over.addEventListener("wheel", (event) => turned(event, made, view), { passive: false });
  return made;
}

/** The time under the pointer. */
export function timeAt(one, event) {
  return one.posToVal(event.clientX - one.over.getBoundingClientRect().left, "x");
}

/** Show the interval of the view with the data there are; y fits what is seen. */
export function redraw(one, view, data = null) {
  if (data) one.setData(data, false);
  const { from, to } = view.range;
  one.setScale("x", { min: from, max: to });
}

function turned(event, one, view) {
  const sideways = event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY);
  const by = (sideways && event.deltaX) || event.deltaY;
  // All is shown: the page scrolls on.
  if (!sideways && by > 0 && !view.stretch) return;
  event.preventDefault();
  if (sideways) view.pan(by / (8 * NOTCH));
  else view.scale(BY_A_NOTCH ** Math.max(-4, Math.min(4, by / NOTCH)), timeAt(one, event));
}

/** Tell `move` of every place that the pointer comes to until it is let go. */
export function whileHeld(move) {
  const ended = new AbortController();
  addEventListener("pointermove", move, { signal: ended.signal });
  for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => ended.abort(), { signal: ended.signal });
}

function drag(event, one, view) {
  const { from, to } = view.range;
  const start = event.clientX;
  const width = one.over.clientWidth;
  whileHeld((moved) => {
    const step = ((start - moved.clientX) / width) * (to - from);
    const first = Math.min(Math.max(from + step, view.whole.from), view.whole.to - (to - from));
    view.go({ from: first, to: first + to - from });
  });
}

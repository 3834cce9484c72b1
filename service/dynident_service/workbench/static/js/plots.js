// What all uPlot figures have in common: colours of the page, axes with units, width of the room they have.

import uPlot from "../vendor/uplot/uPlot.esm.js";

const FONT = "12px system-ui, sans-serif";

/** The page's colour of that name (see style.css), as it is now: light or dark. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** An axis in the page's colours; `side` 2 is below, 3 is left. */
export function axis(label, side) {
  const grid = { stroke: colour("grid"), width: 1 };
  const size = side === 3 ? 64 : 34;
  return { label, side, stroke: colour("soft"), grid, ticks: { ...grid, size: 4 }, font: FONT, labelFont: FONT, labelSize: 18, size };
}

/** A uPlot that keeps to the width of its target until `signal` aborts. */
export function plot(target, options, data, signal) {
  const width = () => Math.max(240, Math.floor(target.clientWidth));
  const made = new uPlot({ ...options, width: width() }, data, target);
  const observer = new ResizeObserver(() => {
    if (target.clientWidth && made.width !== width()) made.setSize({ width: width(), height: options.height });
  });
  observer.observe(target);
  signal?.addEventListener("abort", () => observer.disconnect());
  return made;
}

/** Call `redraw` when the page changes between light and dark. */
export function onColours(redraw, signal) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw, { signal });
}

/** A range around zero, so that up and down compare. */
export function symmetric(_, low, high) {
  const reach = 1.06 * Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0), 1e-9);
  return [-reach, reach];
}

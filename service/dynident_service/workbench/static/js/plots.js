// What all uPlot figures share: colours, axes, size.

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { h, put } from "./dom.js";

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

/** An axis of time, or without words where that of the figure beneath has them. */
export function timeAxis(label) {
  return label ? axis(label, 2) : { ...axis("", 2), label: null, values: (_, splits) => splits.map(() => ""), size: 6 };
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

/** What a legend says of a value: "–" where there is none. */
export function told(words) {
  return (_, raw) => (raw === null || raw === undefined ? "–" : words(raw));
}

/** The two edges of a band, which are not drawn themselves. */
export function edges(names, value) {
  return names.map((label) => ({ label, class: "edge", stroke: "transparent", width: 0, points: { show: false }, value }));
}

/**
 * A figure under its title. `x` and `y` are { label, words(value), values, name (in the legend), axis (more of it) }, `band` { names, ends }, `lines` uPlot's series with their
 * `values`; `options` are more of uPlot's.
 */
export function figure(target, { title, height = 190, x, y, band = null, lines, options = {} }, signal) {
  const value = told(y.words);
  const all = {
    height,
    series: [{ label: x.name ?? x.label, value: told(x.words) }, ...(band ? edges(band.names, value) : []), ...lines.map(({ values, ...line }) => ({ points: { show: false }, value, ...line }))],
    scales: { x: { time: false, ...x.scale }, y: y.scale ?? {} },
    axes: [{ ...axis(x.label, 2), ...x.axis }, { ...axis(y.label, 3), ...y.axis }],
    bands: band ? [{ series: [1, 2], fill: colour("band-wash") }] : [],
    cursor: { drag: { x: false, y: false } },
    legend: { live: true },
    ...options,
  };
  put(target, h("p", { class: "chart-title" }, title));
  return plot(target, all, [x.values, ...(band?.ends ?? []), ...lines.map((one) => one.values)], signal);
}

/** Draw an answer once it is there, and again in other colours; `fail` is told what went wrong, unless nobody waits any more. */
export async function drawn(answer, paint, until, fail) {
  try {
    const found = await answer;
    if (until.aborted) return;
    onColours(() => paint(found), until);
    paint(found);
  } catch (error) {
    if (!until.aborted) fail(error);
  }
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

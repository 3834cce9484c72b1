// Figure of a running design: its criterion falling, beside the best random motion.

import { events } from "../api.js";
import { h } from "../dom.js";
import { number } from "../format.js";
import { axis, colour, onColours, plot } from "../plots.js";

const TOLD = /best within the limits ([\d.e+-]+), best random ([\d.e+-]+)/;
const HEIGHT = 200;

/** Follows a job's events from the first; its element stays hidden until there is a course to draw: one point is in the table. */
export function descent(jobId, signal) {
  const [shares, best, random] = [[], [], []];
  const chart = h("div", { class: "chart" });
  const words = h("p", { class: "note", role: "status" });
  const element = h("section", { hidden: true, id: "descent", "aria-label": "The criterion during the search" }, h("h2", {}, "The criterion during the search"), words, chart);
  let drawn = null;
  let ended = false;

  function show() {
    element.hidden = shares.length < 2;
    if (element.hidden || !element.isConnected) return;
    const data = [shares, best, random];
    words.textContent = `${number(best.at(-1))} ${ended ? "in the end" : "so far"}, within all limits; the best random motion has ${number(random.at(-1))}. Smaller is better.`;
    if (drawn) drawn.setData(data);
    else drawn = plot(chart, options(), data, signal);
  }

  function redraw() {
    drawn?.destroy();
    drawn = null;
    show();
  }

  function add(share, own, other) {
    shares.push(100 * share);
    best.push(own);
    random.push(other);
    show();
  }

  /** What came of it, once it is known. */
  function end({ criterion_values: own, baseline_values: other }) {
    ended = true;
    if (own.criterion && other?.criterion) add(1, own.criterion, other.criterion);
  }

  async function listen() {
    for await (const event of events(jobId, signal)) {
      const found = TOLD.exec(event.message ?? "");
      if (found && !ended) add(event.fraction, Number(found[1]), Number(found[2]));
    }
  }

  onColours(redraw, signal);
  // The chart is an extra: without it the bar still tells how far the search is.
  const told = listen().catch(() => {});
  return { element, end: (result) => told.then(() => end(result)) };
}

function options() {
  return {
    height: HEIGHT,
    scales: { x: { time: false } },
    axes: [axis("share of the search (%)", 2), axis("criterion", 3)],
    series: [{ label: "search (%)" }, { label: "this design", stroke: colour("residual"), width: 2 }, { label: "best random motion", stroke: colour("predicted"), width: 2, dash: [6, 4] }],
  };
}

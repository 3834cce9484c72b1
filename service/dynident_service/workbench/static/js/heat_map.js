// Heat map of the mean residual over two signals.

import { h, svg } from "./dom.js";
import { number } from "./format.js";
import { roundValues } from "./ladder_figures.js";
import { colour } from "./plots.js";
import { signalInWords } from "./residual_profile.js";

const ROOM = { left: 62, right: 96, top: 10, bottom: 44 };
const [WIDTH, HEIGHT] = [620, 320];
const FEWEST = 3;

/** Draw a residual map of two signals. */
export function heatMap(map, model) {
  const { x_edges: xs, y_edges: ys } = map;
  const inner = { width: WIDTH - ROOM.left - ROOM.right, height: HEIGHT - ROOM.top - ROOM.bottom };
  const toX = (value) => ROOM.left + ((value - xs[0]) / (xs.at(-1) - xs[0])) * inner.width;
  const toY = (value) => ROOM.top + inner.height - ((value - ys[0]) / (ys.at(-1) - ys[0])) * inner.height;
  const known = [];
  map.mean.forEach((column, i) => column.forEach((mean, j) => mean !== null && map.count[i][j] >= FEWEST && known.push([i, j, mean])));
  const reach = quantile(known.map(([, , mean]) => Math.abs(mean)), 0.98) || 1;
  const cells = known.map(([i, j, mean]) =>
    svg("rect", { x: toX(xs[i]), y: toY(ys[j + 1]), width: toX(xs[i + 1]) - toX(xs[i]) + 0.4, height: toY(ys[j]) - toY(ys[j + 1]) + 0.4, fill: shade(mean / reach) },
      svg("title", {}, `${number(mean)} ${map.effort_unit} mean, ${number(map.spread[i][j])} spread, ${map.count[i][j]} samples\n${signalInWords(map.x, model)}: ${number(xs[i])} to ${number(xs[i + 1])}\n${signalInWords(map.y, model)}: ${number(ys[j])} to ${number(ys[j + 1])}`)),
  );
  const largest = known.reduce((best, one) => (!best || Math.abs(one[2]) > Math.abs(best[2]) ? one : best), null);
  const words = largest
    ? `Largest mean: ${number(largest[2])} ${map.effort_unit} at ${signalInWords(map.x, model)} ${number(xs[largest[0]])} to ${number(xs[largest[0] + 1])}, ${signalInWords(map.y, model)} ${number(ys[largest[1]])} to ${number(ys[largest[1] + 1])}.`
    : "No cell of the map has enough samples.";
  return h("figure", {},
    svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": words, class: "heat" },
      svg("rect", { x: ROOM.left, y: ROOM.top, width: inner.width, height: inner.height, class: "ground" }),
      cells,
      ticks(xs).map((value) => svg("text", { x: toX(value), y: HEIGHT - ROOM.bottom + 16, "text-anchor": "middle" }, number(value, 2))),
      ticks(ys).map((value) => svg("text", { x: ROOM.left - 6, y: toY(value) + 4, "text-anchor": "end" }, number(value, 2))),
      svg("text", { x: ROOM.left + inner.width / 2, y: HEIGHT - 8, "text-anchor": "middle" }, signalInWords(map.x, model)),
      svg("text", { transform: `translate(14 ${ROOM.top + inner.height / 2}) rotate(-90)`, "text-anchor": "middle" }, signalInWords(map.y, model)),
      legend(inner, reach, map.effort_unit)),
    h("figcaption", { class: "note" }, words),
  );
}

function legend(inner, reach, unit) {
  const left = WIDTH - ROOM.right + 14;
  const steps = 21;
  const height = inner.height - 18;
  const top = ROOM.top + 18;
  const bars = Array.from({ length: steps }, (_, k) => svg("rect", { x: left, y: top + (height * k) / steps, width: 14, height: height / steps + 0.5, fill: shade(1 - (2 * k) / (steps - 1)) }));
  const label = (share) => svg("text", { x: left + 20, y: top + ((1 - share) / 2) * height + 4 }, number(share * reach, 2));
  return [svg("text", { x: left, y: ROOM.top + 8 }, `mean (${unit})`), bars, [1, 0.5, 0, -0.5, -1].map(label)];
}

/** From blue over the ground's colour to orange; beyond the reach as at it. */
function shade(share) {
  const strength = Math.round(100 * Math.min(1, Math.abs(share)));
  return `color-mix(in oklab, ${colour(share > 0 ? "predicted" : "residual")} ${strength}%, ${colour("wash")})`;
}

function ticks(edges, wanted = 5) {
  const [low, high] = [edges[0], edges.at(-1)];
  return roundValues(low, high, (high - low) / wanted);
}

function quantile(values, share) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(share * (sorted.length - 1))] ?? 0;
}

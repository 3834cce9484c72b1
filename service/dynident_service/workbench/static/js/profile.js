// The mean residual of a joint over one signal, with its spread: the shape of what is missing.

import { get } from "./api.js";
import { h, put } from "./dom.js";
import { number, positionUnit } from "./format.js";
import { axis, colour, onColours, plot } from "./plots.js";
import { problemBox } from "./problem.js";

const BINS = 40;
const FEWEST = 5;
const KINDS = { q: ["position", ""], dq: ["velocity", "/s"], ddq: ["acceleration", "/s²"], load: ["load torque", null], tau: ["measured torque", null], temperature: ["temperature", "°C"] };

/** What a signal is, with its unit: "velocity of elbow (rad/s)". */
export function signalInWords(signal, model, withJoint = true) {
  if (signal === "t") return "time (s)";
  const [kind, joint] = apart(signal);
  const [name, more] = KINDS[kind];
  if (kind === "temperature") return withJoint ? `${name} of ${joint} (${more})` : `${name} (${more})`;
  const unit = more === null ? model.unitOf(joint) : `${positionUnit(model.unitOf(joint))}${more}`;
  return withJoint ? `${name} of ${joint} (${unit})` : `${name} (${unit})`;
}

/** All signals of a model's joints; temperature where the measurement has it. */
export function signalsOf(model) {
  const warm = model.measurements.find((one) => one.id === model.measurement)?.has_temperature;
  const kinds = Object.keys(KINDS).filter((kind) => kind !== "temperature" || warm);
  return ["t", ...kinds.flatMap((kind) => model.joints.map((joint) => `${kind}_${joint}`))];
}

/** Draw the residual of `joint` over `signal`; with `before`, that of the model it came from in grey. */
export async function drawProfile(target, model, { comparison, before, joint, signal }, until) {
  const query = { joint, x: signal, bins: BINS };
  const read = (one) => get(`/comparisons/${one.id}/residual_map`, query, until);
  try {
    const [now, then] = await Promise.all([read(comparison), before ? read(before) : null]);
    if (until.aborted) return;
    const draw = () => paint(target, model, { now, then, signal }, until);
    onColours(draw, until);
    draw();
  } catch (error) {
    if (!until.aborted) put(target, problemBox(error));
  }
}

function paint(target, model, { now, then, signal }, until) {
  put(target);
  const unit = now.effort_unit;
  const x = centres(now.x_edges);
  const mean = means(now);
  const spread = now.spread.map(([one]) => one);
  const around = (sign) => mean.map((one, index) => (one === null ? null : one + sign * (spread[index] ?? 0)));
  const value = (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw)} ${unit}`);
  const line = (label, stroke, width) => ({ label, stroke, width, points: { show: false }, value });
  const hidden = { class: "edge", stroke: "transparent", width: 0, points: { show: false }, value };
  const series = [
    { label: signalInWords(signal, model, false), value: (_, raw) => number(raw) },
    { ...hidden, label: "mean + spread" },
    { ...hidden, label: "mean − spread" },
    line("mean residual", colour("residual"), 2),
  ];
  const data = [x, around(1), around(-1), mean];
  if (then) {
    series.push({ ...line("before the last addition", colour("soft"), 1.5), dash: [5, 4] });
    data.push(resampled(then, x));
  }
  const [kind] = apart(signal);
  const options = {
    height: 190,
    series,
    scales: { x: { time: false } },
    axes: [axis(signalInWords(signal, model, false), 2), axis(`residual (${unit})`, 3)],
    bands: [{ series: [1, 2], fill: colour("band-wash") }],
    cursor: { drag: { x: false, y: false } },
    legend: { live: true },
  };
  const title = `Residual of ${now.joint} over ${KINDS[kind]?.[0] ?? "time"}`;
  target.append(h("p", { class: "chart-title" }, title));
  plot(target, options, data, until);
}

function apart(signal) {
  const at = signal.indexOf("_");
  return at < 0 ? [signal, ""] : [signal.slice(0, at), signal.slice(at + 1)];
}

function centres(edges) {
  return edges.slice(1).map((edge, index) => (edge + edges[index]) / 2);
}

function means({ mean, count }) {
  return mean.map(([one], index) => (count[index][0] < FEWEST ? null : one));
}

/** The other model's means at these places: its bins are the same but for rounding. */
function resampled(map, x) {
  const own = means(map);
  const [low, high] = [map.x_edges[0], map.x_edges.at(-1)];
  return x.map((place) => own[Math.floor(((place - low) / (high - low)) * own.length)] ?? null);
}

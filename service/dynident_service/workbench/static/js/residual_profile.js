// Figure of a joint's mean residual over one signal, with its spread.

import { get } from "./api.js";
import { put } from "./dom.js";
import { number, positionUnit } from "./format.js";
import { colour, drawn, figure } from "./plots.js";
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
export function drawProfile(target, model, { comparison, before, joint, signal }, until) {
  const read = (one) => get(`/comparisons/${one.id}/residual_map`, { joint, x: signal, bins: BINS }, until);
  const both = Promise.all([read(comparison), before ? read(before) : null]);
  return drawn(both, ([now, then]) => paint(target, model, { now, then, signal }, until), until, (error) => put(target, problemBox(error)));
}

function paint(target, model, { now, then, signal }, until) {
  const unit = now.effort_unit;
  const x = centres(now.x_edges);
  const mean = means(now);
  const around = (sign) => mean.map((one, index) => (one === null ? null : one + sign * (now.spread[index][0] ?? 0)));
  const lines = [{ label: "mean residual", values: mean, stroke: colour("residual"), width: 2 }];
  if (then) lines.push({ label: "before the last addition", values: resampled(then, x), stroke: colour("soft"), width: 1.5, dash: [5, 4] });
  figure(target, {
    title: `Residual of ${now.joint} over ${KINDS[apart(signal)[0]]?.[0] ?? "time"}`,
    x: { label: signalInWords(signal, model, false), words: number, values: x },
    y: { label: `residual (${unit})`, words: (raw) => `${number(raw)} ${unit}` },
    band: { names: ["mean + spread", "mean − spread"], ends: [around(1), around(-1)] },
    lines,
  }, until);
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

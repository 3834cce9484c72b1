// Revisions of a recording in words, and merged with its metadata.

import { number } from "../format.js";

const KINDS = { q: "positions", tau: "torques" };

/** A body of POST /v1/measurements/{id}/revisions in words: "torque of elbow with the opposite sign; windows 2 to 10 s". */
export function editInWords(edit, joints) {
  const words = {
    windows: (all) => (all.length ? `use ${stretchesInWords(all)}` : "use all of it"),
    exclude: (all) => (all.length ? `leave out ${stretchesInWords(all)}` : "leave nothing out"),
    columns: (map) => Object.entries(map).map(([ours, theirs]) => (theirs === "none" ? `no ${signalInWords(ours, joints)}` : `${signalInWords(ours, joints)} from column ${theirs}`)).join(", "),
    units: (map) => Object.entries(map).map(([kind, unit]) => `${signalInWords(kind, joints)} in ${unit}`).join(", "),
    permutation: (map) => Object.entries(map).map(([kind, order]) => `${KINDS[kind]} in the order ${order.join(", ")}`).join(", "),
    signs: (map) => Object.entries(map).map(([signal, sign]) => `${signalInWords(signal, joints)} ${sign < 0 ? "with the opposite sign" : "as in the file"}`).join(", "),
    scale: (map) => Object.entries(map).map(([signal, factor]) => `${signalInWords(signal, joints)} times ${number(factor)}`).join(", "),
    torque_delay: (delay) => `torque ${number(1000 * delay)} ms late`,
    effort_kind: (kind) => `${kind.replaceAll("_", " ")} as what the torque is`,
    zeros: (map) => Object.entries(map).map(([signal, zero]) => `${signalInWords(signal, joints)} counted from ${number(zero)}`).join(", "),
    skip: (steps) => `without the correction ${steps.map((one) => one.replaceAll("_", " ")).join(", ")}`,
    rate: (rate) => `${number(rate)} rows per second`,
    role: (role) => `used for ${role}`,
    name: (name) => `called ${name}`,
  };
  return Object.entries(edit).filter(([name, value]) => words[name] && value !== null).map(([name, value]) => words[name](value)).join("; ");
}

/** "2 to 10 s, 15 to 30 s". */
export function stretchesInWords(all) {
  return all.map(([from, to]) => `${number(from, 5)} to ${number(to, 5)} s`).join(", ");
}

/** The metadata of an upload with an edit: maps key by key, all else in its place. */
export function withEdit(metadata, edit) {
  const merged = { ...metadata };
  for (const [name, value] of Object.entries(edit)) {
    if (value === null) continue;
    const isMap = typeof value === "object" && !Array.isArray(value);
    // Steps that are left out stay so when another one is.
    const joined = name === "skip" ? [...new Set([...(metadata[name] ?? []), ...value])] : value;
    merged[name] = isMap ? { ...metadata[name], ...value } : joined;
  }
  return merged;
}

/** "torque of elbow" for tau2 or tau_elbow; "torques" for tau. */
export function signalInWords(signal, joints) {
  const names = { q: "position", dq: "velocity", ddq: "acceleration", q_command: "commanded position", tau: "torque", current: "current", temperature: "temperature" };
  const found = /^(q_command|ddq|dq|q|tau|current|temperature)(?:_(.+)|(\d+))?$/.exec(signal);
  if (!found) return signal === "t" ? "time" : signal;
  const [, kind, name, index] = found;
  if (!name && !index) return `${names[kind]}s`.replace("velocitys", "velocities");
  return `${names[kind]} of ${name ?? joints[Number(index) - 1] ?? `joint ${index}`}`;
}

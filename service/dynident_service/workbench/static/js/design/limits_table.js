// Table of joint limits that can be tightened for one design.

import { h, row, table } from "../dom.js";

const KINDS = [["velocity", "/s"], ["acceleration", "/s²"], ["jerk", "/s³"]];

/** Inputs for each joint's limits and noise; `read()` gives { limits, noise } with what was changed. */
export function limitsTable(robot, given) {
  const inputs = []; // { joint, kind, index, read, own }
  const head = ["joint", "from", "to", ...KINDS.map(([name, unit]) => `${name} (unit${unit})`), "effort", "power (W)", "noise σ of the torque"];
  const rows = robot.joints.map((joint) => {
    const turns = joint.type === "revolute";
    const wanted = { ...joint.limits, ...dropNull(given.limits?.[joint.name]) };
    const cell = (kind, value, words, index = null) => {
      const shown = typeof value === "number" ? String(shorten(value)) : "";
      const element = h("input", { type: "number", step: "any", class: "limit", value: shown, "aria-label": `${words} of ${joint.name}` });
      const pointer = kind === "noise" ? `/noise/${joint.name}` : `/limits/${joint.name}/${kind}`;
      const read = () => (element.value === shown ? (value ?? null) : element.value === "" ? null : Number(element.value));
      inputs.push({ joint: joint.name, kind, index, read, own: own(joint, kind, index) });
      return h("div", { "data-pointer": pointer }, element);
    };
    return row([
      [joint.name, h("span", { class: "note" }, turns ? " rad, N\u00a0m" : " m, N")],
      cell("position", wanted.position?.[0], "Lowest position", 0),
      cell("position", wanted.position?.[1], "Highest position", 1),
      ...KINDS.map(([kind]) => cell(kind, wanted[kind], `Largest ${kind}`)),
      cell("effort", wanted.effort, turns ? "Largest torque" : "Largest force"),
      cell("power", wanted.power, "Largest power"),
      cell("noise", given.noise?.[joint.name], "Noise"),
    ]);
  });
  const element = h("fieldset", { "data-pointer": "/limits" }, h("legend", {}, "Limits"),
    h("p", { class: "note" }, "The limits of the robot; your changes apply only to this experiment. If a limit of acceleration or jerk is missing, the design assumes one and reports it. Give the noise σ (N m or N, of one sample) to see the expected standard deviations of the parameters."),
    table("Limits by joint", head, rows, { id: "limits-table" }));
  return { element, read: () => read(robot, inputs) };
}

// A rounded limit is no wider than the robot's. One that is left as it is stays exact.
function shorten(value) {
  // Four digits behind the point; of small numbers four that are not 0.
  const digits = Math.max(4, Math.min(100, 3 - Math.floor(Math.log10(Math.abs(value) || 1))));
  const near = Number(value.toFixed(digits));
  if (Math.abs(near) <= Math.abs(value)) return near;
  return Number((near - Math.sign(value) * 10 ** -digits).toFixed(digits));
}

function read(robot, inputs) {
  const [limits, noise] = [{}, {}];
  for (const { joint, kind, index, read: valueOf, own: before } of inputs) {
    const value = valueOf();
    if (value === null || value === before) continue;
    if (kind === "noise") {
      noise[joint] = value;
      continue;
    }
    limits[joint] ??= {};
    if (index === null) limits[joint][kind] = value;
    else limits[joint].position = bothEnds(inputs, joint);
  }
  return { limits, noise };
}

function bothEnds(inputs, joint) {
  const ends = inputs.filter((one) => one.joint === joint && one.kind === "position");
  return ends.map((one) => one.read());
}

function own(joint, kind, index) {
  const value = kind === "noise" ? null : joint.limits[kind];
  return (index === null ? value : value?.[index]) ?? null;
}

function dropNull(limits) {
  return Object.fromEntries(Object.entries(limits ?? {}).filter(([, value]) => value !== null));
}

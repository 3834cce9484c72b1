// Unfiltered torque, drawn behind the measured torque of a comparison.

import { get, lastAsked } from "../api.js";

const POINTS = 1500;

/** Why the recorded torque of a robot cannot stand behind the filtered one; "" where it can. */
export function whyNoRaw(robot) {
  const coupled = Object.values(robot.request.drives ?? {}).some((one) => Object.keys(one.coupling ?? {}).length);
  return coupled ? "Motors of this robot act on several joints: the recording has the torques of the motors, not of the joints." : "";
}

/** Reads of every joint { t, values } for an interval, null for all. */
export function rawReader(model, signal) {
  const asking = lastAsked(signal);
  return async (stretch) => {
    const until = asking();
    const measurement = model.measurements.find((one) => one.id === model.measurement);
    const delay = measurement.request?.torque_delay ?? 0;
    const shifted = stretch && { from: stretch.from + delay, to: stretch.to + delay };
    const query = { signals: model.joints.map((joint) => `tau_${joint}`).join(","), points: POINTS * model.joints.length, ...(shifted ?? {}) };
    const found = await get(`/measurements/${measurement.id}/raw`, query, until);
    until.throwIfAborted();
    const t = found.t.map((time) => (time === null ? null : time - delay));
    return Object.fromEntries(model.joints.map((joint) => [joint, { t, values: found.signals[`tau_${joint}`] }]));
  };
}

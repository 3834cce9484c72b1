// Decides whether a ladder step made joints worse (from 1.02 times), and which changes are noise.

import { judged } from "./joint_errors.js";

// Rounding and noise move an error by this much though nothing has changed.
const UNCHANGED = 1.005;
// Times its error before: from here on a joint is said to be worse, as in the warnings of the model.
const WORSE = 1.02;

/**
 * What got worse from one step to the next: { total, joints }, on held-out data where both steps have it, where joints
 * move. `total` says that the error of all joints together rose (an effect added has to lower it, or to be confirmed at
 * the reversals or starts that it explains), `joints` names those that got worse.
 */
export function worsened(before, after, joints) {
  const kind = before.validation && after.validation ? "validation" : "residual";
  const [from, to] = [judged(before[kind]), judged(after[kind])];
  const allowed = after.removed.length ? UNCHANGED : 1;
  return {
    total: !(to.relative_total < allowed * from.relative_total) && !after.confirmed_by?.length,
    joints: joints.filter((_, index) => rose(from.relative[index], to.relative[index])),
  };
}

/** A joint without an error, one that does not move, is no worse. */
function rose(from, to) {
  return from !== null && to !== null && to > WORSE * from;
}

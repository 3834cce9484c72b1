// The ways to identify: what each choice is called, and what it is for, in a line.

/** [value, name, what it is for], of the rows of W. */
export const MODELS = [
  ["dynamic", "dynamic", "A row for each joint and instant [12.18]: excites most. The usual choice."],
  ["filtered", "filtered dynamic", "As the dynamic model, but without accelerations [12.28]: for noisy encoders."],
  ["energy", "energy", "One row for each interval [12.43]: neither accelerations nor filters matter; needs a more exciting motion."],
  ["power", "power", "One row for each instant [12.51]: no interval to choose, no infinite gain for offsets; needs a more exciting motion."],
  ["base_wrench", "base wrench", "Six rows from a force-torque sensor under the base: free of joint friction."],
];

export const STRATEGIES = [
  ["global", "all at once", "All parameters from all data. The usual choice."],
  ["sequential", "one after another", "From the end of the arm to its base, with the errors of earlier steps carried on."],
  ["separate_friction", "friction first", "Friction from runs at constant speed (measurements whose role is friction), then the rest."],
];

export const STEPS = [
  ["link_by_link", "link by link", "From the last link to the first [12.22]."],
  ["wrist_then_shoulder", "wrist, then shoulder", "The last three joints, then the others (§12.7): for links of very different size."],
];

export const ESTIMATORS = [
  ["wls", "weighted least squares", "Each joint weighted by its noise. The usual choice."],
  ["ols", "ordinary least squares", "All joints alike [12.5]: strong joints dominate."],
  ["irls", "robust", "Rows that fit badly count less: for recordings with contacts, jumps or other outliers."],
  ["feasible", "physically feasible", "Only bodies that can exist: for motions that do not determine everything, and for simulators."],
  ["iv", "instrumental variables", "Unbiased where noisy encoders pull least squares off; simulates the robot a few times."],
  ["didim", "output error (DIDIM)", "Compares measured with simulated torque; needs positions for the first guess alone."],
  ["ekf", "extended Kalman filter", "Parameters as they emerge, sample by sample."],
];

export const PRIORS = [
  ["", "none", "The data alone count."],
  ["description", "the description's inertias", "Believes the robot's description as far as descriptions can usually be believed: for small motions."],
  ["description_entropic", "the description's bodies (entropic)", "Believes them as bodies, the same in every frame; goes with the estimator physically feasible."],
];

/** Name of a value of one of these lists. */
export function nameIn(list, value) {
  return list.find(([known]) => known === (value ?? ""))?.[1] ?? value;
}

/** A request's method in words. */
export function methodInWords(request) {
  const strategy = request.strategy === "sequential" ? nameIn(STEPS, request.steps) : nameIn(STRATEGIES, request.strategy);
  const prior = request.prior ? `, prior: ${nameIn(PRIORS, request.prior)}` : "";
  return `${nameIn(MODELS, request.model)} model, ${strategy}, ${nameIn(ESTIMATORS, request.estimator)}${prior}`;
}

// State of the model on the page: its resource, comparisons, diagnosis, choices; sections listen for changes.

import { get, post } from "./api.js";
import { catalogue } from "./catalogue.js";
import { computed, newestOf } from "./jobs.js";
import { remember } from "./page_address.js";

const MOST_AHEAD = 1e6; // samples of all joints, which a service compares in about half a second

/** Fires "joint", "limb", "measurement", "diagnosis", "comparison" when that changes, and "zoom" with { from, to }. */
export class Model extends EventTarget {
  #asked = new Map(); // measurement's id -> promise of a comparison
  #tables = new Map(); // diagnosis's id, "" for none -> promise of the model's tables

  constructor(identification, parts, wanted) {
    super();
    this.identification = identification;
    this.result = identification.result;
    Object.assign(this, parts); // robot, effects, rungs, ladder (its tables by name), lastStep, measurements
    this.diagnosis = null;
    this.comparison = null;
    this.limb = this.joints; // those that are looked at
    this.joint = this.joints.includes(wanted.joint) ? wanted.joint : this.#worstJoint();
    const known = this.measurements.map((one) => one.id);
    this.measurement = known.includes(wanted.measurement) ? wanted.measurement : known[0];
  }

  /** Read what belongs to an identification that is done. */
  static async of(identification, wanted, signal) {
    const { measurement_ids: fitted, validation_ids: heldOut } = identification.request;
    const [robot, effects, lineage, ...measurements] = await Promise.all([
      get(`/robots/${identification.robot_id}`, {}, signal),
      catalogue(),
      get(`/identifications/${identification.id}/lineage`, {}, signal),
      ...[...heldOut, ...fitted].map((id) => get(`/measurements/${id}`, {}, signal)),
    ]);
    for (const one of measurements) one.heldOut = heldOut.includes(one.id);
    const { items: rungs, tables, last_step: lastStep } = lineage;
    const ladder = Object.fromEntries(tables.map((one) => [one.name, one]));
    return new Model(identification, { robot, effects, rungs, ladder, lastStep, measurements }, wanted);
  }

  get id() {
    return this.identification.id;
  }

  get joints() {
    return this.result.joints;
  }

  /** Tables of the model by their names, with the noise floor where a diagnosis knows it. */
  async tables(names, signal) {
    const diagnosis = this.diagnosis?.result ? this.diagnosis.id : "";
    const asked = this.#tables.get(diagnosis) ?? get(`/identifications/${this.id}/tables`, diagnosis ? { diagnosis_id: diagnosis } : {}, signal);
    this.#tables.set(diagnosis, asked);
    const { items } = await asked.catch((error) => {
      this.#tables.delete(diagnosis);
      throw error;
    });
    return items.filter((one) => names.includes(one.name));
  }

  /** N m or N. */
  unitOf(joint) {
    return this.result.effort_units[this.joints.indexOf(joint)];
  }

  chooseJoint(joint) {
    if (joint === this.joint) return;
    this.joint = joint;
    remember({ joint });
    this.#tell("joint");
  }

  /** Look at the joints of a limb alone; one of them is the chosen one. */
  chooseLimb(joints) {
    this.limb = this.joints.filter((joint) => joints.includes(joint));
    if (this.limb.length && !this.limb.includes(this.joint)) this.chooseJoint(this.#worstJoint(this.limb));
    this.#tell("limb");
  }

  chooseMeasurement(measurement) {
    if (measurement === this.measurement) return;
    this.measurement = measurement;
    remember({ measurement });
    this.#tell("measurement");
  }

  /** The comparison with a measurement: the newest there is, or a new one that may be on its way; asked for once. */
  async comparedWith(measurement, signal) {
    const asked = this.#asked.get(measurement) ?? requestedComparison(this.id, measurement, signal);
    this.#asked.set(measurement, asked);
    // What failed, or was given up, is asked for again.
    return asked.catch((error) => {
      this.#asked.delete(measurement);
      throw error;
    });
  }

  /** Have the first comparison made before anybody asks for it, if that takes no longer than a moment. */
  async compareAhead(signal) {
    const { n_samples: samples } = this.measurements.find((one) => one.id === this.measurement) ?? {};
    if (!samples || samples * this.joints.length > MOST_AHEAD) return;
    const asked = await this.comparedWith(this.measurement, signal);
    const found = await computed("/comparisons", asked, () => {}, signal);
    this.#asked.set(found.request.measurement_id, Promise.resolve(found));
  }

  setDiagnosis(diagnosis) {
    this.diagnosis = diagnosis;
    this.#tell("diagnosis");
  }

  setComparison(comparison) {
    this.comparison = comparison;
    this.#tell("comparison");
  }

  /** Show an interval of time of a joint. */
  zoomTo(joint, from, to) {
    this.chooseJoint(joint);
    this.dispatchEvent(new CustomEvent("zoom", { detail: { from, to } }));
  }

  /** Whether an effect is in the model on all the joints wanted. */
  contains(choice) {
    const there = this.result.effects.filter((one) => one.effect === choice.effect);
    if (!there.length) return false;
    if (there.some((one) => !one.joints.length)) return true;
    return choice.joints.length > 0 && choice.joints.every((joint) => there.some((one) => one.joints.includes(joint)));
  }

  /** Noise floor of a joint, if this model or one that it came from has been diagnosed. */
  floorOf(joint) {
    return this.diagnosis?.result?.noise_floor[this.joints.indexOf(joint)] ?? null;
  }

  #worstJoint(joints = this.joints) {
    const { relative } = this.result.validation ?? this.result.residual;
    const errorOf = (joint) => relative[this.joints.indexOf(joint)] ?? -1;
    return joints.reduce((worst, joint) => (errorOf(joint) > errorOf(worst) ? joint : worst));
  }

  #tell(kind) {
    this.dispatchEvent(new Event(kind));
  }
}

/** The newest diagnosis of a model, or of the nearest one that it came from; null if there is none. */
export async function newestDiagnosis(model, signal) {
  // What an extension made on its way is no model of its own: nobody could ask about it.
  for (const rung of model.rungs.filter((one) => !one.part_of).reverse()) {
    const usable = await newestOf("/diagnoses", { identification_id: rung.id }, signal);
    // Lists have no tables.
    if (usable) return get(`/diagnoses/${usable.id}`, {}, signal);
  }
  return null;
}

/** The newest comparison of a model with a measurement that is done or on its way; undefined if there is none. */
export function existingComparison(modelId, measurementId, signal) {
  return newestOf("/comparisons", { identification_id: modelId, limit: 100 }, signal, (one) => one.request.measurement_id === measurementId);
}

/** The newest comparison of a model with a measurement, or a new one. */
export async function requestedComparison(modelId, measurementId, signal) {
  const existing = await existingComparison(modelId, measurementId, signal);
  // Lists have no tables.
  if (existing) return get(`/comparisons/${existing.id}`, {}, signal);
  return post("/comparisons", { identification_id: modelId, measurement_id: measurementId }, { signal });
}

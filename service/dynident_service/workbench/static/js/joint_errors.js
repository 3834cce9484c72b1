// Table of a model's errors by joint; which error a model is judged by.

import { figures, h, jointButton, listed, numeric, put, right, section } from "./dom.js";
import { number, percent, quantity } from "./format.js";

/** The errors that models are judged and compared by: where joints move; on all rows where none does, or nobody knows. */
export function judged(errors) {
  return errors.moving && errors.moving.relative_total !== null ? errors.moving : errors;
}

/** A table of errors that follows the diagnosis, for the noise floor, and the joint that is chosen. */
export function errorsSection(model) {
  const body = h("div");
  const show = () => put(body, errorsTable(model));
  model.addEventListener("diagnosis", show);
  model.addEventListener("joint", show);
  show();
  return section("errors", "Errors", body);
}

function errorsTable(model) {
  const { residual, validation } = model.result;
  const hasFloor = Boolean(model.diagnosis?.result);
  const kinds = [["fit", residual], ["held out", validation]].filter(([, errors]) => errors);
  // Behind the joints stands the total of all, which has no rms; models of older versions know nothing of rest: their rows all count as moving ones.
  const of = (errors, joint) => (joint ? errors.relative[model.joints.indexOf(joint)] : errors.relative_total);
  const columns = [
    ["joint", (joint) => (joint ? jointButton(model, joint, { class: "plain" }) : "all joints")],
    ...kinds.flatMap(([kind, errors]) => [
      [right(`${kind}, moving, rms`), (joint, k) => (joint ? numeric(quantity((errors.moving ?? errors).rms[k], model.unitOf(joint)), (errors.moving ?? errors).rms[k]) : "")],
      figures(`${kind}, moving (%)`, (joint) => of(errors.moving ?? errors, joint), (value) => percent(value)),
      figures(`${kind}, all rows (%)`, (joint) => of(errors, joint), (value) => percent(value)),
    ]),
    hasFloor && [right("noise floor, rms"), (joint) => (joint ? numeric(quantity(model.floorOf(joint), model.unitOf(joint)), model.floorOf(joint)) : "")],
    hasFloor && [right("fit over floor"), (joint, k) => (joint ? numeric(overFloor(model.floorOf(joint), residual.rms[k])) : "")],
  ];
  const rowProps = (joint) => ({ class: !joint ? "total" : joint === model.joint ? "chosen" : null });
  const notes = [
    "Relative errors are ‖y − ŷ‖ / ‖y‖ of the filtered, decimated torque: where the joint moves, and on all rows. At standstill, only the distance to the range of static friction counts.",
    hasFloor ? "The noise floor is the residual that the torque sensor's noise alone causes; no model can be better than 1 times the floor." : "Diagnose the model to see the noise floor.",
    validation ? "" : "There is no validation data. Hold out a measurement to see the error on data that the fit has not seen.",
  ];
  return [listed("Error per joint", columns, [...model.joints, null], { id: "error-table" }, rowProps), h("p", { class: "note" }, notes.join(" "))];
}

function overFloor(floor, rms) {
  return floor && rms !== null ? `${number(rms / floor, 2)} ×` : "–";
}

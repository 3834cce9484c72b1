// The errors of a model, joint by joint.

import { h, numeric, put, right, row, section, table } from "./dom.js";
import { number, percent, quantity } from "./format.js";

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
  const columns = (kind) => [`${kind}, moving, rms`, `${kind}, moving (%)`, `${kind}, all rows (%)`].map(right);
  const head = ["joint", ...columns("fit")];
  if (validation) head.push(...columns("held out"));
  if (hasFloor) head.push(...["noise floor, rms", "fit over floor"].map(right));
  const rows = model.joints.map((joint, index) => {
    const unit = model.unitOf(joint);
    const cells = [jointButton(model, joint), ...figures(residual, index, unit)];
    if (validation) cells.push(...figures(validation, index, unit));
    if (hasFloor) cells.push(...floorOf(model, joint, residual.rms[index], unit));
    return row(cells, { class: joint === model.joint ? "chosen" : null });
  });
  const total = ["all joints", ...totals(residual)];
  if (validation) total.push(...totals(validation));
  if (hasFloor) total.push("", "");
  rows.push(row(total, { class: "total" }));
  const notes = [
    "Relative errors are ‖y − ŷ‖ / ‖y‖ on the filtered, decimated torque: where the joint moves, and on all rows, where at rest the distance to what static friction may hold counts.",
    hasFloor ? "The noise floor is what the torque sensor's noise alone leaves; 1 times the floor is as good as a model can be." : "Diagnose the model to see the noise floor.",
    validation ? "" : "There is no validation data: an error on data that the fit has not seen tells more.",
  ];
  return [table("Error per joint", head, rows, { id: "error-table" }), h("p", { class: "note" }, notes.join(" "))];
}

function jointButton(model, joint) {
  const pressed = joint === model.joint ? "true" : "false";
  return h("button", { type: "button", class: "plain", "aria-pressed": pressed, onclick: () => model.chooseJoint(joint) }, joint);
}

/** Models of older versions know nothing of rest: their rows all count as moving ones. */
function figures(errors, index, unit) {
  const { rms, relative } = errors.moving ?? errors;
  return [numeric(quantity(rms[index], unit), rms[index]), numeric(percent(relative[index]), relative[index]), numeric(percent(errors.relative[index]), errors.relative[index])];
}

function totals(errors) {
  const moving = (errors.moving ?? errors).relative_total;
  return ["", numeric(percent(moving), moving), numeric(percent(errors.relative_total), errors.relative_total)];
}

function floorOf(model, joint, rms, unit) {
  const floor = model.floorOf(joint);
  return [numeric(quantity(floor, unit), floor), numeric(floor && rms !== null ? `${number(rms / floor, 2)} ×` : "–")];
}

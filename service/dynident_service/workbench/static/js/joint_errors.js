// Table of a model's errors by joint; which error a model is judged by.

import { h, jointButton, put, section } from "./dom.js";
import { orSay } from "./problem.js";
import { shownTable } from "./tables.js";

/** The errors that models are judged and compared by: where joints move; on all rows where none does, or nobody knows. */
export function judged(errors) {
  return errors.moving && errors.moving.relative_total !== null ? errors.moving : errors;
}

/** A table of errors that follows the diagnosis, for the noise floor, and the joint that is chosen. */
export function errorsSection(model, signal) {
  const body = h("div");
  let shown = null;
  const show = () => shown && put(body, errorsTable(model, shown));
  const read = () => orSay(body, async () => {
    [shown] = await model.tables(["errors"], signal);
    show();
  }, signal, read);
  model.addEventListener("diagnosis", read);
  model.addEventListener("joint", show);
  read();
  return section("errors", "Errors", body);
}

/** Behind the joints stands the total of all. */
function errorsTable(model, shown) {
  const joint = (k) => model.joints[k];
  const rowProps = (k) => ({ class: !joint(k) ? "total" : joint(k) === model.joint ? "chosen" : null });
  return shownTable(shown, { id: "error-table" }, { rowProps, wrap: { 0: (content, k) => (joint(k) ? jointButton(model, joint(k), { class: "plain" }) : content) } });
}

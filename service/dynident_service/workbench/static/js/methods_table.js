// All methods on the same data, in one table.

import { h, numeric, right, row, table } from "./dom.js";
import { number, percent } from "./format.js";

/** Held-out error of each joint and method, and how far parameters and torque are from the first method's. */
export function methodsTable(model, result) {
  const solved = result.methods.filter((one) => one.held_out);
  const best = Math.min(...solved.map((one) => one.held_out.relative_total));
  const head = ["method", ...[...model.joints, "all joints"].map(right), right("distance, σ"), "most in", right("torque"), right("± of it"), right("time")];
  const rows = solved.map((one) =>
    row([
      one.method,
      ...one.held_out.relative.map((value) => numeric(percent(value), value)),
      { class: "n", text: h("data", { value: one.held_out.relative_total }, one.held_out.relative_total === best ? h("strong", {}, percent(best)) : percent(one.held_out.relative_total)) },
      numeric(number(one.distance_rms, 2), one.distance_rms),
      one.distance_rms ? h("code", {}, one.farthest) : "",
      numeric(percent(one.torque_distance), one.torque_distance),
      numeric(percent(one.torque_deviation), one.torque_deviation),
      { class: "n", text: `${number(one.seconds, 2)} s` },
    ]),
  );
  const without = result.methods.filter((one) => !one.held_out);
  return [
    table("Relative held-out error by method; distance of the parameters and of the predicted torque from the first", head, rows, { id: "methods-table" }),
    without.length
      ? h("details", {}, h("summary", {}, `Methods that this data does not allow (${without.length})`), h("ul", {}, without.map((one) => h("li", {}, h("strong", {}, one.method), `: ${one.problem}`))))
      : null,
  ];
}

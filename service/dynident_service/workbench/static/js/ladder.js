// The ladder of models: what was added at each rung, and the error falling, in total and on every joint.

import { choiceInWords } from "./catalogue.js";
import { h, numeric, row, table } from "./dom.js";
import { number, percent } from "./format.js";
import { jointsFigure, totalsFigure } from "./ladder_figures.js";
import { address } from "./location.js";

/** Of a model that came from another. */
export function ladderSection(model) {
  const rungs = model.rungs.filter((one) => one.residual);
  const heldOut = rungs.every((one) => one.validation);
  const errors = rungs.map((one) => (heldOut ? one.validation : one.residual));
  const kind = heldOut ? "held out" : "fit";
  return h(
    "section",
    { "aria-labelledby": "ladder-title" },
    h("h2", { id: "ladder-title", tabindex: "-1" }, "Ladder"),
    h("p", { class: fell(model) ? "box good" : "box warning", id: "step" }, stepInWords(model)),
    h("div", { class: "two" }, totalsFigure(rungs, heldOut), jointsFigure(errors, model.joints, kind)),
    rungTable(model, rungs, heldOut),
    jointTable(model, errors, kind),
  );
}

/** What the last step did, in words. */
export function stepInWords(model) {
  const [before, after] = model.rungs.slice(-2);
  const added = after.added.map((one) => choiceInWords(model.effects, one, model.joints)).join("; ");
  const change = (name, from, to) => `${name} ${percent(from.relative_total)} → ${percent(to.relative_total)}`;
  const parts = [change("error of the fit", before.residual, after.residual)];
  if (before.validation && after.validation) parts.unshift(change("held-out error", before.validation, after.validation));
  const advice = fell(model) ? "" : " It did not help on data that the fit has not seen: think before you keep it.";
  return `Added ${added}: ${parts.join(", ")}.${advice}`;
}

function fell(model) {
  const [before, after] = model.rungs.slice(-2);
  const kind = before.validation && after.validation ? "validation" : "residual";
  return after[kind].relative_total < before[kind].relative_total;
}

function rungTable(model, rungs, heldOut) {
  const head = ["model", "added", right("base parameters"), right("fit (%)")];
  if (heldOut) head.push(right("held out (%)"));
  const rows = rungs.map((one, index) => {
    const here = one.id === model.id;
    const link = here ? h("strong", {}, `${index + 1}`) : h("a", { href: address({ identification: one.id }) }, `${index + 1}`);
    const added = one.added.map((choice) => choiceInWords(model.effects, choice, model.joints)).join("; ") || "the first model";
    const cells = [link, added, numeric(String(one.n_parameters)), error(one.residual.relative_total)];
    if (heldOut) cells.push(error(one.validation.relative_total));
    return row(cells, { class: here ? "chosen" : null });
  });
  return table("Models, first to last, all joints", head, rows, { id: "ladder-table" });
}

function jointTable(model, errors, kind) {
  const head = ["joint", ...errors.map((_, index) => right(`model ${index + 1} (%)`)), right("last over first")];
  const rows = model.joints.map((joint, index) => {
    const values = errors.map((one) => one.relative[index]);
    const ratio = values[0] && values.at(-1) !== null ? `${number(values.at(-1) / values[0], 2)} ×` : "–";
    return row([joint, ...values.map(error), numeric(ratio)]);
  });
  return table(`Relative error per joint, ${kind}`, head, rows, { id: "ladder-joints" });
}

function error(value) {
  return numeric(percent(value), value);
}

function right(text) {
  return { text, class: "n" };
}

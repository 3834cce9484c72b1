// The ladder of models: what was added at each rung, and the error falling, in total and on every joint.

import { choiceInWords } from "./catalogue.js";
import { h, numeric, put, right, row, table, unseen } from "./dom.js";
import { number, percent } from "./format.js";
import { totalsFigure } from "./ladder_figures.js";
import { address } from "./location.js";
import { nextRung } from "./next_rung.js";
import { problemBox } from "./problem.js";
import { worsened } from "./step.js";
import { changeOf, twoLadders } from "./two_ladders.js";
import { waterfallFigure } from "./waterfall.js";

/** Of a model that came from another; of a first model only the comparison with others. */
export function ladderSection(model, signal) {
  if (model.rungs.length < 2) return h("section", { "aria-label": "Ladders" }, twoLadders(model, signal));
  const rungs = model.rungs.filter((one) => one.residual);
  const heldOut = rungs.every((one) => one.validation);
  const errors = rungs.map((one) => (heldOut ? one.validation : one.residual));
  const kind = heldOut ? "held out" : "fit";
  return h(
    "section",
    { "aria-labelledby": "ladder-title" },
    h("h2", { id: "ladder-title", tabindex: "-1" }, "Ladder"),
    h("p", { class: isBetter(worseIn(model)) ? "box good" : "box warning", id: "step" }, stepInWords(model)),
    h("div", { class: "two wide-right" }, totalsFigure(rungs, heldOut), waterfall(model, errors, kind)),
    rungTable(model, rungs, heldOut, signal),
    jointTable(model, errors, kind),
    twoLadders(model, signal),
  );
}

/** From the model that this one was made from to this one: an extension by several effects has a rung for each. */
function lastStep(model) {
  const index = model.rungs.findIndex((one) => one.id === model.identification.parent_id);
  const first = index < 0 ? model.rungs.length - 2 : index;
  return { before: model.rungs[first], after: { ...model.rungs.at(-1), added: model.rungs.slice(first + 1).flatMap((one) => one.added) } };
}

/** What the last step did, in words. */
export function stepInWords(model) {
  const { before, after } = lastStep(model);
  const names = (list) => list.map((one) => choiceInWords(model.effects, one, model.joints)).join("; ");
  const change = (name, from, to) => `${name} ${percent(from.relative_total)} → ${percent(to.relative_total)}`;
  const parts = [change("error of the fit", before.residual, after.residual)];
  if (before.validation && after.validation) parts.unshift(change("held-out error", before.validation, after.validation));
  const worse = worseIn(model);
  const where = worse.joints.length ? ` Worse than before on ${worse.joints.join(", ")}: see the table per joint before you keep it.` : "";
  if (after.removed.length) {
    const loss = worse.total ? " The error is larger without it." : worse.joints.length ? "" : " It was not missed.";
    return `Removed ${names(after.removed)}: ${parts.join(", ")}.${loss}${where}`;
  }
  const unseen = before.validation && after.validation ? " on data that the fit has not seen" : "";
  const advice = worse.total ? ` It did not help${unseen}: think before you keep it.` : "";
  return `Added ${names(after.added)}: ${parts.join(", ")}.${advice}${where}`;
}

function worseIn(model) {
  const { before, after } = lastStep(model);
  return worsened(before, after, model.joints);
}

function isBetter(worse) {
  return !worse.total && !worse.joints.length;
}

function rungTable(model, rungs, heldOut, signal) {
  const head = ["model", "change", right("base parameters"), right("fit (%)")];
  if (heldOut) head.push(right("held out (%)"), right("held out, moving (%)"), unseen("the best"));
  head.push("");
  const rows = rungs.map((one, index) => {
    const here = one.id === model.id;
    const link = here ? h("strong", {}, `${index + 1}`) : one.part_of ? `${index + 1}` : h("a", { href: address({ identification: one.id, tab: "missing" }) }, `${index + 1}`);
    const cells = [link, changeOf(model, one), numeric(String(one.n_parameters)), error(one.residual.relative_total)];
    if (heldOut) cells.push(error(one.validation.relative_total), error(one.validation.moving?.relative_total ?? null), markOf(one));
    cells.push(removeButton(model, one, signal));
    return row(cells, { class: here ? "chosen" : null });
  });
  return [table("Models, first to last, all joints", head, rows, { id: "ladder-table" }), h("p", { id: "best-rung" }, bestInWords(rungs), keepBest(model, rungs))];
}

/** Drawn anew when a diagnosis tells what the noise is. */
function waterfall(model, errors, kind) {
  const body = h("div");
  const draw = () => put(body, waterfallFigure(errors, model.joints, model.joints.map((joint) => model.floorOf(joint) ?? null), kind));
  model.addEventListener("diagnosis", draw);
  draw();
  return body;
}

/** What a rung is on held-out data. */
function markOf(rung) {
  if (rung.best) return h("span", { class: "mark ok" }, "✓ best");
  return rung.rises ? h("span", { class: "mark warning" }, "↑ rises") : "";
}

function bestInWords(rungs) {
  const [best, rises] = [rungs.findIndex((one) => one.best), rungs.findIndex((one) => one.rises)];
  if (best < 0) return "";
  const found = `Model ${best + 1} predicts held-out data best`;
  return rises < 0 ? `${found}.` : `${found}; from model ${rises + 1} on the held-out error is larger: what was added there does not help.`;
}

/** A way back to the best rung; what an extension made on its way is no model that could be gone to. */
function keepBest(model, rungs) {
  const best = rungs.findIndex((one) => one.best);
  if (best < 0 || rungs[best].id === model.id || rungs[best].part_of) return null;
  return [" ", h("a", { class: "button", id: "keep-best", href: address({ identification: rungs[best].id, tab: "missing", joint: model.joint }) }, `Keep the best: model ${best + 1}`)];
}

/** Takes what a rung added out of the model that is looked at; the other rungs stay. */
function removeButton(model, rung, signal) {
  const there = rung.added.filter((one) => model.contains(one));
  if (!there.length) return "";
  const said = h("div");
  const button = h("button", { type: "button", class: "small", "aria-label": `Remove ${changeOf(model, { added: there, removed: [] })}`, onclick: () => remove() }, "Remove");
  const remove = async () => {
    button.disabled = true;
    try {
      const effects = there.map(({ effect, joints }) => ({ effect, joints }));
      await nextRung(model, "remove", effects, said, signal);
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error));
      button.disabled = false;
    }
  };
  return [button, said];
}

function jointTable(model, errors, kind) {
  const head = ["joint", ...errors.map((_, index) => right(`model ${index + 1} (%)`)), right("last over first")];
  const rows = model.joints.map((joint, index) => {
    const values = errors.map((one) => one.relative[index]);
    const ratio = values[0] && values.at(-1) !== null ? `${(values.at(-1) / values[0]).toFixed(2)} ×` : "–";
    return row([joint, ...values.map(error), numeric(ratio)]);
  });
  return table(`Relative error per joint, ${kind}`, head, rows, { id: "ladder-joints" });
}

function error(value) {
  return numeric(percent(value), value);
}

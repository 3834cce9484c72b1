// Section of the ladder of models: what each step added, its errors in total and by joint.

import { choiceInWords } from "./catalogue.js";
import { figures, h, listed, numeric, put, right, unseen } from "./dom.js";
import { judged } from "./joint_errors.js";
import { percent } from "./format.js";
import { totalsFigure } from "./ladder_figures.js";
import { address } from "./page_address.js";
import { nextRung } from "./extended_model.js";
import { pressed, problemBox } from "./problem.js";
import { worsened } from "./ladder_step.js";
import { changeOf, twoLadders } from "./two_ladders.js";
import { waterfallFigure } from "./waterfall.js";

/** Of a model that came from another; of a first model only the comparison with others. */
export function ladderSection(model, signal) {
  if (model.rungs.length < 2) return h("section", { "aria-label": "Ladders" }, twoLadders(model, signal));
  const rungs = model.rungs.filter((one) => one.residual);
  const heldOut = rungs.every((one) => one.validation);
  const errors = rungs.map((one) => judged(heldOut ? one.validation : one.residual));
  const kind = `${heldOut ? "held out" : "fit"}, where it moves`;
  return h("section", { "aria-labelledby": "ladder-title" },
    h("h2", { id: "ladder-title", tabindex: "-1" }, "Ladder"),
    h("p", { class: isBetter(worseIn(model)) ? "box good" : "box warning", id: "step" }, stepInWords(model)),
    h("div", { class: "two wide-right" }, totalsFigure(rungs, heldOut), waterfall(model, errors, kind)),
    rungTable(model, rungs, heldOut, signal),
    jointTable(model, errors, kind),
    twoLadders(model, signal),
  );
}

/** From the model that this one was made from to this one: an extension by several effects has a step for each. */
function lastStep(model) {
  const index = model.rungs.findIndex((one) => one.id === model.identification.parent_id);
  const first = index < 0 ? model.rungs.length - 2 : index;
  return { before: model.rungs[first], after: { ...model.rungs.at(-1), added: model.rungs.slice(first + 1).flatMap((one) => one.added) } };
}

/** What the last step did, in words. */
export function stepInWords(model) {
  const { before, after } = lastStep(model);
  const names = (list) => list.map((one) => choiceInWords(model.effects, one, model.joints)).join("; ");
  const change = (name, from, to) => `${name} ${percent(judged(from).relative_total)} → ${percent(judged(to).relative_total)}`;
  const parts = [change("error of the fit", before.residual, after.residual)];
  if (before.validation && after.validation) parts.unshift(change("held-out error", before.validation, after.validation));
  const worse = worseIn(model);
  const where = worse.joints.length ? ` Worse than before on ${worse.joints.join(", ")}: see the table per joint before you keep it.` : "";
  if (after.removed.length) {
    const loss = worse.total ? " The error is larger without it." : worse.joints.length ? "" : " The model does not need it.";
    return `Removed ${names(after.removed)}: where joints move, ${parts.join(", ")}.${loss}${where}`;
  }
  const unseen = before.validation && after.validation ? " on data that the fit has not seen" : "";
  const advice = worse.total ? ` It did not help${unseen}: consider removing it.` : "";
  return `Added ${names(after.added)}: where joints move, ${parts.join(", ")}.${confirmedInWords(after)}${advice}${where}`;
}

/** What confirms an effect besides the rows where joints move. */
function confirmedInWords({ confirmed_by: rows }) {
  const words = (rows ?? []).filter((one) => one !== "moving").map((one) => (one === "reversing" ? "at reversals" : "at starts"));
  return words.length ? ` Held-out data confirm it ${words.join(" and ")}.` : "";
}

function worseIn(model) {
  const { before, after } = lastStep(model);
  return worsened(before, after, model.joints);
}

function isBetter(worse) {
  return !worse.total && !worse.joints.length;
}

function rungTable(model, rungs, heldOut, signal) {
  const linkOf = (one, k) => {
    if (one.id === model.id) return h("strong", {}, `${k + 1}`);
    return one.part_of ? `${k + 1}` : h("a", { href: address({ identification: one.id, tab: "missing" }) }, `${k + 1}`);
  };
  const columns = [
    ["model", linkOf],
    ["change", (one) => changeOf(model, one)],
    [right("base parameters"), (one) => numeric(String(one.n_parameters))],
    figures("fit, moving (%)", (one) => judged(one.residual).relative_total, (value) => percent(value)),
    heldOut && figures("held out, moving (%)", (one) => judged(one.validation).relative_total, (value) => percent(value)),
    heldOut && figures("held out, all rows (%)", (one) => one.validation.relative_total, (value) => percent(value)),
    heldOut && [unseen("the best"), markOf],
    ["", (one) => removeButton(model, one, signal)],
  ];
  const rowProps = (one) => ({ class: one.id === model.id ? "chosen" : null });
  return [listed("Models, first to last, all joints", columns, rungs, { id: "ladder-table" }, rowProps), h("p", { id: "best-rung" }, bestInWords(rungs), keepBest(model, rungs))];
}

/** Drawn anew when a diagnosis tells what the noise is. */
function waterfall(model, errors, kind) {
  const body = h("div");
  const draw = () => put(body, waterfallFigure(errors, model.joints, model.joints.map((joint) => model.floorOf(joint) ?? null), kind));
  model.addEventListener("diagnosis", draw);
  draw();
  return body;
}

/** What a step is on held-out data. */
function markOf(rung) {
  if (rung.best) return h("span", { class: "mark ok" }, "✓ best");
  return rung.rises ? h("span", { class: "mark warning" }, "↑ rises") : "";
}

function bestInWords(rungs) {
  const [best, rises] = [rungs.findIndex((one) => one.best), rungs.findIndex((one) => one.rises)];
  if (best < 0) return "";
  const found = `Model ${best + 1} predicts held-out data best`;
  return rises < 0 ? `${found}.` : `${found}; from model ${rises + 1} on the held-out error is larger: the steps from there on do not help.`;
}

/** A way back to the best step; what an extension made on its way is no model that could be gone to. */
function keepBest(model, rungs) {
  const best = rungs.findIndex((one) => one.best);
  if (best < 0 || rungs[best].id === model.id || rungs[best].part_of) return null;
  return [" ", h("a", { class: "button", id: "keep-best", href: address({ identification: rungs[best].id, tab: "missing", joint: model.joint }) }, `Keep the best: model ${best + 1}`)];
}

/** Takes what a step added out of the model that is looked at; the other steps stay. */
function removeButton(model, rung, signal) {
  const there = rung.added.filter((one) => model.contains(one));
  if (!there.length) return "";
  const said = h("div");
  const button = h("button", { type: "button", class: "small", "aria-label": `Remove ${changeOf(model, { added: there, removed: [] })}`, onclick: () => remove() }, "Remove");
  const effects = there.map(({ effect, joints }) => ({ effect, joints }));
  const remove = () => pressed(button, () => nextRung(model, "remove", effects, said, signal), (error) => put(said, problemBox(error)), signal);
  return [button, said];
}

function jointTable(model, errors, kind) {
  const ratio = (first, last) => (first && last !== null ? `${(last / first).toFixed(2)} ×` : "–");
  const columns = [
    ["joint", (joint) => joint],
    ...errors.map((one, index) => figures(`model ${index + 1} (%)`, (_, k) => one.relative[k], (value) => percent(value))),
    [right("last over first"), (_, k) => numeric(ratio(errors[0].relative[k], errors.at(-1).relative[k]))],
  ];
  return listed(`Relative error per joint, ${kind}`, columns, model.joints, { id: "ladder-joints" });
}

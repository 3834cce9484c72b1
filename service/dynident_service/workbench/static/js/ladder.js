// Section of the ladder of models: what each step added, its errors in total and by joint.

import { h, put } from "./dom.js";
import { judged } from "./joint_errors.js";
import { totalsFigure } from "./ladder_figures.js";
import { address } from "./page_address.js";
import { nextRung } from "./extended_model.js";
import { pressed, problemBox } from "./problem.js";
import { shownTable } from "./tables.js";
import { twoLadders } from "./two_ladders.js";
import { waterfallFigure } from "./waterfall.js";

/** Of a model that came from another; of a first model only the comparison with others. */
export function ladderSection(model, signal) {
  if (!model.lastStep) return h("section", { "aria-label": "Ladders" }, twoLadders(model, signal));
  const rungs = model.rungs.filter((one) => one.residual);
  const heldOut = rungs.every((one) => one.validation);
  const errors = rungs.map((one) => judged(heldOut ? one.validation : one.residual));
  const kind = `${heldOut ? "held out" : "fit"}, where it moves`;
  return h("section", { "aria-labelledby": "ladder-title" },
    h("h2", { id: "ladder-title", tabindex: "-1" }, "Ladder"),
    h("p", { class: model.lastStep.is_better ? "box good" : "box warning", id: "step" }, model.lastStep.text),
    h("p", {}, h("a", { class: "button", id: "compare-parent", href: address({ view: "models", pair: [model.identification.parent_id, model.id].join(",") }) }, "Compare the curves of both models")),
    h("div", { class: "two wide-right" }, totalsFigure(rungs, heldOut), waterfall(model, errors, kind)),
    rungTable(model, rungs, signal),
    shownTable(model.ladder.joints, { id: "ladder-joints" }),
    twoLadders(model, signal),
  );
}

function rungTable(model, rungs, signal) {
  const linkOf = (number, k) => {
    if (rungs[k].id === model.id) return h("strong", {}, number);
    return rungs[k].part_of ? number : h("a", { href: address({ identification: rungs[k].id, tab: "missing" }) }, number);
  };
  const { notes, ...shown } = model.ladder.ladder;
  const rowProps = (k) => (rungs[k].id === model.id ? { class: "chosen" } : {});
  return [
    shownTable(shown, { id: "ladder-table" }, { wrap: { 0: linkOf }, more: [["", (k) => removeButton(model, rungs[k], signal)]], rowProps }),
    h("p", { id: "best-rung" }, notes, keepBest(model, rungs)),
  ];
}

/** Drawn anew when a diagnosis tells what the noise is. */
function waterfall(model, errors, kind) {
  const body = h("div");
  const draw = () => put(body, waterfallFigure(errors, model.joints, model.joints.map((joint) => model.floorOf(joint) ?? null), kind));
  model.addEventListener("diagnosis", draw);
  draw();
  return body;
}

/** A way back to the best step; what an extension made on its way is no model that could be gone to. */
function keepBest(model, rungs) {
  const best = rungs.findIndex((one) => one.best);
  if (best < 0 || rungs[best].id === model.id || rungs[best].part_of) return null;
  return [" ", h("a", { class: "button", id: "keep-best", href: address({ identification: rungs[best].id, tab: "missing", joint: model.joint }) }, `Go back to model ${best + 1}`)];
}

/** Takes what a step added out of the model that is looked at; the other steps stay. */
function removeButton(model, rung, signal) {
  const there = rung.added.filter((one) => model.contains(one));
  if (!there.length) return "";
  const said = h("div");
  const button = h("button", { type: "button", class: "small", "aria-label": `Remove ${rung.change}`, onclick: () => remove() }, "Remove");
  const effects = there.map(({ effect, joints }) => ({ effect, joints }));
  const remove = () => pressed(button, () => nextRung(model, "remove", effects, said, signal), (error) => put(said, problemBox(error)), signal);
  return [button, said];
}

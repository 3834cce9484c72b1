// Section that compares the ladders of two models, as figure and table.

import { get, lastAsked } from "./api.js";
import { choiceInWords } from "./catalogue.js";
import { field, h, put, select } from "./dom.js";
import { judged } from "./joint_errors.js";
import { moment } from "./format.js";
import { laddersFigure } from "./ladder_figures.js";
import { address } from "./page_address.js";
import { orSay } from "./problem.js";
import { shownTable } from "./tables.js";

/** Folded away until somebody asks for it. */
export function twoLadders(model, signal) {
  const body = h("div", { id: "two-ladders" });
  const details = h("details", { id: "compare-ladders", ontoggle: () => open() }, h("summary", {}, "Compare with other models"), body);
  let filled = false;
  const open = () => {
    if (filled || !details.open) return;
    filled = true;
    orSay(body, async () => {
      const { items } = await get("/identifications", { robot_id: model.identification.robot_id, limit: 100, brief: true }, signal);
      put(body, chooser(model, items.filter((one) => one.status === "succeeded" && one.id !== model.id), signal));
    }, signal);
  };
  return details;
}

function chooser(model, others, signal) {
  if (!others.length) return h("p", { class: "note" }, "There is no other model of this robot.");
  const figure = h("div");
  const drawing = lastAsked(signal);
  const show = (against) => {
    const mine = drawing();
    orSay(figure, async () => put(figure, shown(await get(`/identifications/${model.id}/lineage`, { against }, mine))), mine);
  };
  const options = others.map((one) => [one.id, `${one.name || model.robot.name}, ${changeOf(model, one)}, ${moment(one.created_at)}`]);
  const pick = select(options, options[0][0], show, { id: "other-ladder" });
  show(options[0][0]);
  return [field("Model whose ladder is compared with this one", pick), figure];
}

/** What a step changed, in words. */
function changeOf(model, rung) {
  const words = (one) => choiceInWords(model.effects, one, model.joints);
  return [...rung.added.map(words), ...rung.removed.map((one) => `without ${words(one)}`)].join("; ") || "first model";
}

function shown(found) {
  const [own, other] = [found.items, found.against];
  const heldOut = [...own, ...other].every((one) => one.validation);
  const kind = heldOut ? "validation" : "residual";
  const totals = (rungs) => rungs.filter((one) => one[kind]).map((one) => judged(one[kind]).relative_total);
  return [
    found.same_data ? null : h("p", { class: "box warning" }, "Not all of these models use the same recordings, so their errors are not comparable."),
    both(totals(own), totals(other), heldOut),
    differences(found),
  ];
}

function both(own, other, heldOut) {
  const lines = [
    { name: "this ladder", css: "held-out", marker: "square", values: own },
    { name: "the other", css: "fit", marker: "circle", values: other },
  ];
  const label = heldOut ? "Held-out relative error where joints move (%)" : "Relative error of the fit where joints move (%)";
  return laddersFigure(label, 560, lines, (line, k) => {
    if (line.values === own) return { dx: 10, dy: 4, anchor: "start" };
    // Where both ladders have the same model its figure stands once.
    return other[k] === own[k] ? null : { dx: -10, dy: 4, anchor: "end" };
  });
}

function differences(found) {
  const table = found.tables.find((one) => one.name === "two_ladders");
  const linkTo = (rungs) => (content, k) => (rungs[k] && !rungs[k].part_of ? h("a", { href: address({ identification: rungs[k].id, tab: "missing" }) }, content) : content);
  const rowProps = (k) => {
    const one = found.differences[k];
    return { class: one.id === found.common_ancestor && one.id === one.against_id ? "total" : null };
  };
  return shownTable(table, { id: "ladder-differences" }, { wrap: { 1: linkTo(found.items), 3: linkTo(found.against) }, rowProps });
}

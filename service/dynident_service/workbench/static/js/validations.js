// Section of validations: run them, show verdicts with reasons.

import { get, post } from "./api.js";
import { announce, h, put, section } from "./dom.js";
import { awaited } from "./jobs.js";
import { driftFigure } from "./ladder_figures.js";
import { pressed, problemBox } from "./problem.js";
import { foldedTable } from "./tables.js";

const OPEN = new Set(["methods", "bootstrap"]); // Here the table is the answer.

/** The verdict of a validation in words, which is the first of its tables. */
const verdictOf = ({ tables }) => tables[0].rows[0][1].text;

/** A line for each kind of validation, with what the newest of its kind found; each can be made anew. */
export function validationsSection(model, kinds, signal) {
  const lines = new Map(kinds.map((kind) => [kind.name, lineOf(model, kind, signal)]));
  const run = h("button", { type: "button", class: "main", id: "validate-all", onclick: () => all() }, "Validate");
  const all = async () => {
    run.disabled = true;
    for (const [kind, line] of lines) if (usable(model, kind)) await line.validate();
    run.disabled = false;
  };
  known(model, lines, signal).catch((error) => {
    if (!signal.aborted) throw error;
  });
  return section("validations", "Can the model be trusted?",
    h("p", { class: "actions" }, run, h("span", { class: "note" }, "runs all of these except the last, one after another")),
    h("ul", { class: "verdicts" }, [...lines.values()].map((line) => line.element)),
  );
}

/** Ids of the newest validation of every kind that has ended. */
export async function newestValidations(model, kinds) {
  const newest = await newestByKind(model, (one) => one.status === "succeeded");
  return kinds.map(({ name }) => newest.get(name)?.id).filter(Boolean);
}

/** By their kinds the newest validations of a model that fit. */
async function newestByKind(model, fits, signal) {
  const { items } = await get("/validations", { identification_id: model.id, limit: 100 }, signal);
  return new Map(items.filter(fits).reverse().map((one) => [one.request.kind, one]));
}

function usable(model, kind) {
  if (kind === "cross" || kind === "collision") return model.measurements.some((one) => one.heldOut);
  return kind !== "payload";
}

/** Measurements whose role is payload, which state what the load weighs. */
async function loads(model, signal) {
  const { items } = await get("/measurements", { robot_id: model.robot.id, limit: 200 }, signal);
  return items.filter((one) => one.role === "payload").map((one) => one.id);
}

function lineOf(model, { name: kind, label, words: about }, signal) {
  const name = label[0].toUpperCase() + label.slice(1);
  const chip = h("span", { class: "chip verdict none" }, "not made yet");
  const button = h("button", { type: "button", class: "small", "aria-label": `Validate: ${name}`, onclick: () => validate() }, "Run");
  const said = h("div", { class: "reason" }, h("span", { class: "note" }, about));
  const element = h("li", { "data-kind": kind }, h("div", { class: "verdict-head" }, h("strong", { title: about }, name), chip, button), said);
  const show = (validation) => {
    const { result } = validation;
    chip.className = `chip verdict ${result.verdict}`;
    put(chip, verdictOf(validation));
    put(said, h("p", {}, result.reason), details(validation, kind), result.drift ? driftFigure(result.drift) : null);
    button.textContent = "Again";
  };
  const wait = async (made) => {
    const found = await awaited("/validations", made, `${name} validation`, said, signal);
    show(found);
    if (made.status !== "succeeded") {
      announce(`${name}: ${verdictOf(found)}. ${found.result.reason}`);
      model.dispatchEvent(new Event("validated"));
    }
  };
  const validate = async () => {
    await pressed(button, async () => {
      const body = { identification_id: model.id, kind };
      if (kind === "payload") {
        body.measurement_ids = await loads(model, signal);
        if (!body.measurement_ids.length) {
          put(said, h("p", { class: "note" }, "There is no recording whose role is payload. Record the motion of the identification with a load, and upload it with the mass of the load."));
          return;
        }
      }
      await wait(await post("/validations", body, { signal }));
    }, (error) => put(said, problemBox(error)), signal);
  };
  return { element, validate, wait };
}

/** Show what is known already: the newest validation of every kind. */
async function known(model, lines, signal) {
  const newest = await newestByKind(model, (one) => !["failed", "cancelled"].includes(one.status), signal);
  for (const [kind, one] of newest) lines.get(kind)?.wait(one).catch(() => {});
}

/** The figures behind the verdict; `kind` names the first table. */
function details({ tables }, kind) {
  return tables.slice(1).map((one, k) => foldedTable(one, { id: k ? null : `${kind}-table` }, {}, OPEN.has(kind) && !k));
}

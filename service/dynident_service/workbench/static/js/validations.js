// Is the model to be trusted: the validations of the chapter, each with its verdict and the reason.

import { get, post } from "./api.js";
import { announce, h, numeric, put, right, row, section, table } from "./dom.js";
import { number, percent, quantity } from "./format.js";
import { computed, progressBar } from "./jobs.js";
import { methodsTable } from "./methods_table.js";
import { pressed, problemBox } from "./problem.js";

const WORDS = { pass: "✓ pass", fail: "✕ fail", not_evaluated: "– not evaluated" };

/** A line for each kind of validation, with what the newest of its kind found; each can be made anew. */
export function validationsSection(model, kinds, signal) {
  const lines = new Map(kinds.map((kind) => [kind.name, lineOf(model, kind, signal)]));
  const run = h("button", { type: "button", class: "main", id: "validate-all", onclick: () => all() }, "Validate");
  const all = async () => {
    run.disabled = true;
    for (const [kind, line] of lines) if (usable(model, kind)) await line.validate();
    run.disabled = false;
  };
  known(model, lines, signal);
  return section("validations", "Is it to be trusted",
    h("p", { class: "actions" }, run, h("span", { class: "note" }, "makes all but the last of these, one after another")),
    h("ul", { class: "verdicts" }, [...lines.values()].map((line) => line.element)),
  );
}

/** Ids of the newest validation of every kind that has ended. */
export async function newestValidations(model, kinds) {
  const { items } = await get("/validations", { identification_id: model.id, limit: 100 });
  const newest = new Map(items.filter((one) => one.status === "succeeded").reverse().map((one) => [one.request.kind, one.id]));
  return kinds.map(({ name }) => newest.get(name)).filter(Boolean);
}

function usable(model, kind) {
  if (kind === "cross") return model.measurements.some((one) => one.heldOut);
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
    put(chip, WORDS[result.verdict]);
    put(said, h("p", {}, result.reason), details(model, result));
    button.textContent = "Again";
  };
  const wait = async (made) => {
    const bar = progressBar(made.job_id, `${name} validation`);
    put(said, bar.element);
    const found = await computed("/validations", made, bar.update, signal);
    show(found);
    announce(`${name}: ${WORDS[found.result.verdict]}. ${found.result.reason}`);
  };
  const validate = async () => {
    await pressed(button, async () => {
      const body = { identification_id: model.id, kind };
      if (kind === "payload") {
        body.measurement_ids = await loads(model, signal);
        if (!body.measurement_ids.length) {
          put(said, h("p", { class: "note" }, "There is no measurement whose role is payload. Record the motion of the identification with a load, and upload it with what the load weighs."));
          return;
        }
      }
      await wait(await post("/validations", body, { signal }));
    }, (error) => put(said, problemBox(error)), signal);
  };
  return { element, validate, show, wait };
}

/** Show what is known already: the newest validation of every kind. */
async function known(model, lines, signal) {
  try {
    const { items } = await get("/validations", { identification_id: model.id, limit: 100 }, signal);
    for (const [kind, line] of lines) {
      const newest = items.find((one) => one.request.kind === kind && one.status !== "failed" && one.status !== "cancelled");
      if (newest?.status === "succeeded") line.show(newest);
      else if (newest) line.wait(newest).catch(() => {});
    }
  } catch (error) {
    if (!signal.aborted) throw error;
  }
}

function drawnTable(drawn) {
  const head = ["parameter", "unit", right("told"), right("drawn"), right("ratio"), right("expected"), ""];
  const rows = drawn.parameters.map((one) =>
    row([
      h("code", {}, one.name),
      one.unit,
      numeric(number(one.told, 2), one.told),
      numeric(number(one.drawn, 2), one.drawn),
      numeric(number(one.ratio, 3), one.ratio),
      { class: "n", text: `${number(one.expected[0], 3)} to ${number(one.expected[1], 3)}` },
      one.outside ? h("span", { class: "mark warning" }, "! outside") : "✓",
    ]),
  );
  return table("Standard deviations as told, and over draws", head, rows);
}

function details(model, result) {
  if (result.methods.length) return methodsTable(model, result);
  if (result.simulations.some((one) => one.torque)) return simulationsTable(model, result);
  if (result.filters) return filtersTable(result.filters);
  if (result.bootstrap?.parameters.length) return drawnTable(result.bootstrap);
  if (result.payloads.length) return payloadTable(result.payloads);
  if (result.measurements.length) return errorsTable(model, result);
  if (result.worst_posture) return postureTable(result);
  return null;
}

function folded(title, inner) {
  return h("details", {}, h("summary", {}, title), inner);
}

function shares(errors) {
  return [...errors.relative, errors.relative_total].map((value) => numeric(percent(value), value));
}

function heads(model) {
  return [...model.joints, "all joints"].map(right);
}

function errorsTable(model, result) {
  const rows = result.measurements.map((one) => row([one.name, ...shares(one.errors)]));
  return folded("Relative error of each joint", table("Relative torque error", ["measurement", ...heads(model)], rows));
}

function simulationsTable(model, result) {
  const rows = result.simulations.filter((one) => one.torque).flatMap((one) => [
    row([`${one.name}: torque`, ...shares(one.torque)]),
    row([`${one.name}: position, of its range`, ...one.position_share.map((value) => numeric(percent(value, 2), value)), ""]),
  ]);
  return folded("Each joint", table("Simulated against recorded", ["", ...heads(model)], rows));
}

function postureTable(result) {
  const rows = Object.entries(result.worst_posture).map(([joint, value]) => row([joint, numeric(number(value, 3), value)]));
  return folded(`The worst of ${result.postures_tried} postures`, table("Worst posture", ["joint", right("rad or m")], rows));
}

function filtersTable(filters) {
  const cutoff = (value) => (value === null ? "none" : quantity(value, "Hz"));
  const rows = filters.trials.map((one) => {
    const { position_cutoff: position, torque_cutoff: torque } = one.preprocessing;
    const same = (other) => JSON.stringify(one) === JSON.stringify(other);
    const mark = [same(filters.used) ? "used" : null, same(filters.chosen) ? "smallest error" : null].filter(Boolean).join(", ");
    return row([cutoff(position), cutoff(torque), numeric(percent(one.error, 3), one.error), numeric(percent(one.bias, 3), one.bias), mark || one.problem || ""]);
  });
  const head = ["position cut-off", "torque cut-off", right("parameter error"), right("bias"), ""];
  return folded(`${rows.length} choices of filters`, table("What each choice of filters leaves in the parameters, as a share of the torque", head, rows));
}

function payloadTable(payloads) {
  const mass = (value) => (value === null ? "–" : quantity(value, "kg"));
  const rows = payloads.map((one) => row([one.name, mass(one.stated_mass), mass(one.mass), one.interval ? `${number(one.interval[0])} to ${number(one.interval[1])} kg` : "not identifiable", mass(one.friction_shared), mass(one.friction_apart)]));
  const head = ["measurement", "stated", "weighed", "95 % interval", "with common friction", "with friction of each run"];
  return folded("The load", table("Mass of the load", head, rows));
}

// Form and table of the changes between an earlier and a later set of measurements.

import { get } from "./api.js";
import { placeOf, titleOf } from "./catalogue.js";
import { figures, h, listed, numeric, put, right, row, table } from "./dom.js";
import { interval, number, pValue, percent } from "./format.js";
import { orSay, sending } from "./problem.js";
import { usesOf } from "./measurement_uses.js";

const SETS = [["", "leave out"], ["before", "before"], ["after", "after"]];

/** A form that asks for a diagnosis against a baseline; `ask(body)` starts it. */
export function changesForm(model, ask, signal) {
  const fitted = model.identification.request.measurement_ids;
  const said = h("div");
  const uses = usesOf(SETS, { usual: (one) => (fitted.includes(one.id) ? "before" : ""), called: "Use", id: "days" });
  const submit = h("button", { class: "main", id: "what-changed" }, "What has changed?");
  const send = sending(submit, said, async () => {
    const [before, after] = [uses.chosen("before"), uses.chosen("after")];
    if (!before.length || !after.length) return void put(said, h("p", { class: "box warning" }, "Choose at least one measurement before and one after."));
    await ask({ identification_id: model.id, baseline_ids: before, measurement_ids: after });
  }, signal);
  const fill = () => orSay(said, async () => uses.update((await get("/measurements", { robot_id: model.robot.id, limit: 200 }, signal)).items), signal);
  return h("details", { id: "changes-form", ontoggle: (event) => { if (event.target.open) fill(); } },
    h("summary", {}, "What has changed since an earlier day?"),
    h("form", { onsubmit: send }, uses.element, h("p", { class: "actions" }, submit), said));
}

/** The changes that a diagnosis found, and what friction did, each with its interval; nothing where it had no baseline. */
export function changesTable(model, result) {
  if (!result.changes) return null;
  return h("div", {}, changedTable(model, result), frictionTable(result));
}

function changedTable(model, result) {
  if (!result.changes.length) return h("p", { class: "box good", id: "changes" }, "These recordings show no change since the baseline.");
  const rows = result.changes.flatMap((one) => changeRows(model, one));
  const head = ["changed", "where", "parameter", right("before"), right("difference"), right("95 % interval"), right("p"), "evidence"];
  return h("div", { id: "changes" }, table("Changes since the baseline", head, rows));
}

function frictionTable(result) {
  if (!result.friction?.length) return null;
  const reach = Math.max(1e-9, ...result.friction.filter((one) => one.before > 0).flatMap(shares).map(Math.abs));
  const columns = [
    ["joint", (one) => h("code", {}, one.joint)],
    [right("at a speed of"), (one) => ({ class: "n", text: `${number(one.speed)} ${one.unit === "N" ? "m/s" : "rad/s"}` })],
    figures("before", (one) => one.before, (value) => number(value)),
    figures("difference", (one) => one.value, (value) => number(value)),
    [right("95 % interval"), (one) => ({ class: "n", text: interval(...one.interval, one.unit) })],
    figures("relative to before", (one) => (one.before > 0 ? one.value / one.before : null), (value) => percent(value)),
    [`−${percent(reach)} to +${percent(reach)}`, (one) => (one.before > 0 ? spanOf(one, reach) : "")],
  ];
  return h("div", { id: "friction-since" }, listed("Friction of each joint since the baseline, significant or not", columns, result.friction));
}

function shares(one) {
  return [one.value, ...one.interval].map((value) => value / one.before);
}

/** A difference and its interval on a line whose middle is none; in colour where the interval is on one side of it. */
function spanOf(one, reach) {
  const [value, low, high] = shares(one);
  const place = (share) => `${(50 + (50 * share) / reach).toFixed(1)}%`;
  const band = h("span", { class: "band", style: { left: place(low), width: `${((50 * (high - low)) / reach).toFixed(1)}%` } });
  const dot = h("span", { class: low <= 0 && high >= 0 ? "dot" : "dot told", style: { left: place(value) } });
  return h("span", { class: "span-of", role: "img", "aria-label": `${percent(low)} to ${percent(high)}` }, band, dot);
}

/** A row for each value of a change; `first` are cells before the others, of its first row. */
export function changeRows(model, one, first = []) {
  return [one, ...one.more].map((value) => row([
    ...first.map((cell) => (value === one ? cell : "")),
    value === one ? titleOf(model.effects, one.effect) : "",
    value === one ? placeOf(model.effects, one, model.joints) : "",
    h("code", {}, value.parameter),
    numeric(number(value.before), value.before ?? ""),
    numeric(number(value.value), value.value),
    { class: "n", text: interval(...value.interval, value.unit) },
    numeric(value === one ? pValue(one.p_value) : "", one.p_value),
    value === one ? said(model, one) : "",
  ], { "data-change": value === one ? one.effect : null }));
}

function said(model, one) {
  const others = one.equivalent.map((name) => titleOf(model.effects, name) ?? name).join(", ");
  return [one.evidence, others ? h("strong", {}, ` These data cannot distinguish it from: ${others}.`) : null];
}

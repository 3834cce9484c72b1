// Form and table of the changes between an earlier and a later set of measurements.

import { get } from "./api.js";
import { h, put } from "./dom.js";
import { percent } from "./format.js";
import { orSay, sending } from "./problem.js";
import { byName, shownTable } from "./tables.js";
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
    if (!before.length || !after.length) return void put(said, h("p", { class: "box warning" }, "Choose at least one recording before and one after."));
    await ask({ identification_id: model.id, baseline_ids: before, measurement_ids: after });
  }, signal);
  const fill = () => orSay(said, async () => uses.update((await get("/measurements", { robot_id: model.robot.id, limit: 200 }, signal)).items), signal);
  return h("details", { id: "changes-form", ontoggle: (event) => { if (event.target.open) fill(); } },
    h("summary", {}, "What has changed since an earlier day?"),
    h("form", { onsubmit: send }, uses.element, h("p", { class: "actions" }, submit), said));
}

/** The changes that a diagnosis found, and what friction did, each with its interval; nothing where it had no baseline. */
export function changesTable(diagnosis) {
  const { result } = diagnosis;
  if (!result.changes) return null;
  const { changes: changed, friction } = byName(diagnosis);
  const reach = Math.max(1e-9, ...result.friction.filter((one) => one.before > 0).flatMap(shares).map(Math.abs));
  const span = [`−${percent(reach)} to +${percent(reach)}`, (k) => (result.friction[k].before > 0 ? spanOf(result.friction[k], reach) : "")];
  return h("div", {},
    h("div", { id: "changes" }, changed ? shownChanges(changed, result) : null),
    friction ? h("div", { id: "friction-since" }, shownTable(friction, {}, { more: [span] })) : null);
}

/** A row for each value of a change. */
export function shownChanges(table, { changes }) {
  const effects = changes.flatMap((one) => [one.effect, ...one.more.map(() => null)]);
  return shownTable(table, {}, { rowProps: (k) => ({ "data-change": effects[k] }) });
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

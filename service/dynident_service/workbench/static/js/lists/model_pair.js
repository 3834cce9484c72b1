// Page of two models side by side: settings, errors, parameters, exports; differences are marked.

import { get } from "../api.js";
import { catalogue, choiceInWords } from "../catalogue.js";
import { h, numeric, part, put, right, row, table } from "../dom.js";
import { judged } from "../joint_errors.js";
import { interval, moment, number, percent, quantity } from "../format.js";
import { address } from "../page_address.js";
import { methodInWords, methods } from "../methods.js";
import { exportLinks } from "../save_file.js";
import { overlaySection } from "./torque_overlay.js";

/** Show two models, given by their ids. */
export async function pairSection(target, ids, signal) {
  const [effects, ways, ...models] = await Promise.all([catalogue(), methods(), ...ids.slice(0, 2).map((id) => get(`/identifications/${id}`, {}, signal))]);
  const robots = await Promise.all(models.map((one) => get(`/robots/${one.robot_id}`, {}, signal)));
  const names = models.map((one, index) => one.name || robots[index].name);
  if (names[0] === names[1]) names.forEach((name, index) => { names[index] = `${name} (${"AB"[index]})`; });
  document.title = `${names.join(" and ")}: dynident`;
  const head = h("section", {}, h("p", {}, h("a", { href: address({ view: "models" }) }, "← All models")), h("h1", {}, names.join(" and ")),
    h("p", { class: "note" }, "Rows that differ are marked. Each name leads to its model."),
    h("ul", {}, models.map((one, index) => h("li", {}, h("a", { href: address({ identification: one.id }) }, names[index]), `, ${moment(one.created_at)}`))));
  const missing = models.length < 2 || models.some((one) => !one.result);
  if (missing) {
    put(target, head, h("div", { class: "box warning" }, "Choose two finished models in the list of all models."));
    return;
  }
  put(target, head, settings(models, robots, names, effects, ways), errors(models, names), overlaySection(models, names, signal), parameters(models, names), exported(models, names, ways));
}

function settings(models, robots, names, effects, ways) {
  const [a, b] = models.map((one) => one.result.preprocessing);
  const pairs = [
    ["robot", ...robots.map((one) => one.name)],
    ["method", ...models.map((one) => methodInWords(ways, one.request))],
    ["recordings of the fit", ...models.map((one) => listed(one, "measurement_ids"))],
    ["recordings held out", ...models.map((one) => listed(one, "validation_ids"))],
    ["position filter", quantity(a.position_cutoff, "Hz"), quantity(b.position_cutoff, "Hz")],
    ["torque filter", quantity(a.torque_cutoff, "Hz"), quantity(b.torque_cutoff, "Hz")],
    ["decimation", String(a.decimation), String(b.decimation)],
    ["equations", ...models.map((one) => String(one.result.n_equations))],
    ["tags", ...models.map((one) => one.tags.join(", ") || "–")],
  ];
  const inWords = models.map((one) => one.result.effects.map((choice) => choiceInWords(effects, choice, one.result.joints)));
  const all = [...new Set(inWords.flat())];
  const rows = [...pairs, ...all.map((one) => [one, ...inWords.map((own) => (own.includes(one) ? "in the model" : "–"))])];
  return part("Settings", table("Settings of both models", ["setting", ...names], rows.map(([name, one, other]) => row([name, one, other], differs(one !== other))), { id: "pair-settings" }));
}

function listed(model, which) {
  const seen = new Map((model.result.measurements ?? []).map((one) => [one.id, one.name]));
  return model.request[which].map((id) => seen.get(id) ?? id).join(", ") || "none";
}

function errors(models, names) {
  const joints = [...new Set(models.flatMap((one) => one.result.joints))];
  const errorsOf = (model, kind) => (model.result[kind] ? judged(model.result[kind]) : null);
  const of = (model, kind, joint) => errorsOf(model, kind)?.relative[model.result.joints.indexOf(joint)] ?? null;
  const rows = [...joints.map((joint) => [joint, (model, kind) => of(model, kind, joint)]), ["all joints", (model, kind) => errorsOf(model, kind)?.relative_total ?? null]].map(([name, value]) => {
    const four = ["validation", "residual"].map((kind) => models.map((one) => value(one, kind)));
    return row([name, ...four.flatMap(([one, other]) => [numeric(percent(one), one), numeric(percent(other), other), { class: "n", text: change(one, other) }])], name === "all joints" ? { class: "total" } : {});
  });
  const head = ["joint", ...["held out", "fit"].flatMap((kind) => [right(`${names[0]}, ${kind}`), right(`${names[1]}, ${kind}`), right("second over first")])];
  return part("Errors", table("Relative errors where joints move, by joint", head, rows, { id: "pair-errors" }));
}

function change(one, other) {
  return one && other !== null ? `${number(other / one, 2)} ×` : "–";
}

function parameters(models, names) {
  const found = models.map((one) => new Map(one.result.parameters.map((two) => [two.name, two])));
  const all = [...new Set(found.flatMap((one) => [...one.keys()]))];
  const rows = all.map((name) => {
    const [one, other] = found.map((own) => own.get(name));
    const distance = one && other ? apart(one, other) : null;
    const cells = [one, other].flatMap((own) => [own ? numeric(number(own.value), own.value) : { class: "n", text: "not in it" }, { class: "n", text: own ? interval(...own.interval, "") : "" }]);
    return row([h("code", {}, name), (one ?? other).unit, ...cells, numeric(number(distance, 2), distance)], differs(!one || !other || distance > 2));
  });
  const head = ["parameter", "unit", ...names.flatMap((name) => [right(name), right("95 % interval")]), right("distance, σ")];
  return part("Parameters", h("p", { class: "note" }, "Marked: parameters of one model only, or with a difference above two joint standard deviations. If only one model groups a parameter with others, its two values do not mean the same."), table("Parameters with their 95 % intervals", head, rows, { id: "pair-parameters" }));
}

/** Distance of two values over the standard deviation of their difference. */
function apart(one, other) {
  const spread = Math.hypot(one.standard_deviation ?? 0, other.standard_deviation ?? 0);
  return spread ? Math.abs(one.value - other.value) / spread : null;
}

function exported(models, names, ways) {
  return part("Exports", models.map((one, index) => {
    const said = h("div");
    return [h("p", { class: "actions" }, h("strong", {}, names[index]), exportLinks(one, ways.exports, said)), said];
  }));
}

function differs(yes) {
  return yes ? { class: "chosen", "data-differs": "yes" } : {};
}

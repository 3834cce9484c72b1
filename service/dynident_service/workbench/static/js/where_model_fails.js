// Section on where a model fails: residual over one or two signals, and the diagnosis's map.

import { get, lastAsked } from "./api.js";
import { field, h, jointButton, put, section, select } from "./dom.js";
import { heatMap } from "./heat_map.js";
import { existingComparison } from "./shown_model.js";
import { orSay } from "./problem.js";
import { byName, shownTable } from "./tables.js";
import { drawProfile, signalInWords, signalsOf } from "./residual_profile.js";

const OVER = ["dq", "q", "load"];
const SPOTS = 8;

/** Follows the joint, the comparison and the diagnosis. */
export function failureSection(model, signal) {
  const profiles = h("div", { class: "profiles" });
  const map = h("div");
  const spots = h("div");
  const drawing = lastAsked(signal);

  const draw = async () => {
    const until = drawing();
    const { comparison, joint } = model;
    if (!comparison) return;
    const before = await earlier(model, until);
    if (until.aborted) return;
    const targets = OVER.map(() => h("div", { class: "chart" }));
    put(profiles, targets);
    OVER.forEach((kind, index) => drawProfile(targets[index], model, { comparison, before, joint, signal: `${kind}_${joint}` }, until));
    put(map, mapOfTwo(model, until));
  };
  model.addEventListener("comparison", draw);
  model.addEventListener("joint", draw);
  const showSpots = () => put(spots, worstPlaces(model));
  model.addEventListener("diagnosis", showSpots);
  model.addEventListener("limb", showSpots);
  showSpots();
  return section("fails", "Where it fails",
    h("p", { class: "note" }, "If the mean is flat at zero, nothing is missing; the shaded band is the spread around the mean."),
    profiles,
    map,
    spots,
  );
}

/** The comparison of the model before this one with the same measurement, if there is one. */
export async function earlier(model, signal) {
  const parent = model.identification.parent_id;
  if (!parent) return null;
  const found = await existingComparison(parent, model.measurement, signal).catch(() => null);
  return found?.status === "succeeded" ? found : null;
}

function mapOfTwo(model, signal) {
  const { comparison, joint } = model;
  const chosen = { x: `q_${joint}`, y: `dq_${joint}` };
  const figure = h("div");
  const drawing = lastAsked(signal);
  const draw = () => {
    const mine = drawing();
    return orSay(figure, async () => put(figure, heatMap(await get(`/comparisons/${comparison.id}/residual_map`, { joint, ...chosen, bins: 28 }, mine), model)), mine);
  };
  const pick = (name) =>
    select(signalsOf(model).map((one) => [one, signalInWords(one, model)]), chosen[name], (value) => {
      chosen[name] = value;
      draw();
    });
  draw();
  return [h("h3", {}, `Residual of ${joint} over two signals`), h("div", { class: "bar-of-fields" }, field("Across", pick("x")), field("Up", pick("y"))), figure];
}

function worstPlaces(model) {
  const { diagnosis } = model;
  const table = diagnosis?.result && byName(diagnosis).worst_places;
  if (!table) return null;
  const rows = table.rows.filter((_, k) => model.limb.includes(diagnosis.result.failure_map[k].joint));
  const shown = (some, id) => shownTable({ ...table, rows: some }, { id }, { wrap: { 0: (_, k) => jointButton(model, some[k][0].text, { class: "plain" }) } });
  return [shown(rows.slice(0, SPOTS), "failure-map"), rows.length > SPOTS ? h("details", {}, h("summary", {}, `${rows.length - SPOTS} more`), shown(rows.slice(SPOTS), "more-places")) : null];
}

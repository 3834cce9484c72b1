// Section on where a model fails: residual over one or two signals, and the diagnosis's map.

import { get, lastAsked } from "./api.js";
import { field, figures, h, listed, numeric, put, right, section, select } from "./dom.js";
import { number, span } from "./format.js";
import { heatMap } from "./heat_map.js";
import { existingComparison } from "./shown_model.js";
import { orSay } from "./problem.js";
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
  const showSpots = () => put(spots, failureMap(model));
  model.addEventListener("diagnosis", showSpots);
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

function failureMap(model) {
  const spots = model.diagnosis?.result?.failure_map ?? [];
  if (!spots.length) return null;
  const columns = [
    ["joint", (one) => h("button", { type: "button", class: "plain", onclick: () => model.chooseJoint(one.joint) }, one.joint)],
    ["over", (one) => one.variable],
    ["where", (one) => span(one.low, one.high, one.unit)],
    figures("rms there", (one) => one.rms, (value, one) => `${number(value)} ${model.unitOf(one.joint)}`),
    [right("times the joint's own rms"), (one) => numeric(one.ratio === null ? "–" : `${number(one.ratio)} ×`)],
  ];
  const whose = model.diagnosis.request.identification_id === model.id ? "" : " of the diagnosed model, without later additions,";
  const more = spots.slice(SPOTS);
  return [
    listed(`Where the residual${whose} is largest`, columns, spots.slice(0, SPOTS), { id: "failure-map" }),
    more.length ? h("details", {}, h("summary", {}, `${more.length} more`), listed("More places", columns, more)) : null,
  ];
}

// Map of detection limits: effects by joints.

import { titleOf } from "./catalogue.js";
import { h, row, table } from "./dom.js";
import { number } from "./format.js";

const WHOLE = "whole robot";

/** The detection limits, folded away: effects by joints, in shares of the usual size; null where there are none. */
export function detectionLimits(model, result) {
  const limits = result.detection_limits ?? [];
  if (!limits.length) return null;
  const places = [...model.joints.filter((joint) => limits.some((one) => one.joints[0] === joint))];
  if (limits.some((one) => !one.joints.length)) places.push(WHOLE);
  const effects = [...new Set(limits.map((one) => one.effect))];
  const rows = effects.map((effect) => {
    const cells = places.map((place) => cell(limits.find((one) => one.effect === effect && (one.joints[0] ?? WHOLE) === place)));
    return row([{ text: titleOf(model.effects, effect), scope: "row" }, ...cells]);
  });
  const note = "The smallest size of each effect that these recordings would have shown with 95\u202f%, divided by its usual size on arms. Blue: the usual size would have shown. Grey: no size would. Blank: found, in the model, or not possible on that joint. Hover over a cell for the size in its unit.";
  return h("details", { id: "limits" },
    h("summary", {}, `What these data would have shown (${limits.filter((one) => one.share !== null && one.share <= 1).length} of ${limits.length} in their usual size)`),
    h("p", { class: "note" }, note),
    h("div", { class: "limits" }, table("Detection limits over usual sizes", ["effect", ...places], rows)),
  );
}

function cell(limit) {
  if (!limit) return "";
  const unit = limit.unit === "-" ? "" : ` ${limit.unit}`;
  const usual = `usually ${number(limit.usual)}${unit}`;
  const title = limit.size === null ? `${limit.parameter}: no size would have shown; ${usual}` : `${limit.parameter}: from ${number(limit.size)}${unit} on; ${usual}`;
  return h("data", { value: limit.share ?? "", class: `limit ${levelOf(limit.share)}`, title }, words(limit.share));
}

function levelOf(share) {
  if (share === null) return "none";
  return share > 3 ? "far" : share > 1 ? "above" : share > 0.3 ? "near" : "below";
}

function words(share) {
  if (share === null) return "–";
  return share < 0.995 ? `${Number((100 * share).toPrecision(2))}\u202f%` : `${share < 10 ? Number(share.toPrecision(2)) : Math.round(share)} ×`;
}

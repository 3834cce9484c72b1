// Evidence figure of an effect: the residual over its variable, with the fitted effect.

import { get, lastAsked } from "./api.js";
import { aboutEffect } from "./catalogue.js";
import { h, put } from "./dom.js";
import { number } from "./format.js";
import { formula } from "./formula.js";
import { colour, drawn, figure } from "./plots.js";

/** The figure of a candidate, and what the effect is. */
export function evidenceOf(model, one, signal) {
  const figure = h("div", { class: "chart" });
  drawEvidence(figure, model.diagnosis, one.rank, signal);
  return { figure, about: aboutEffect(model.effects, one.effect, formula) };
}

/** Draw the figure of a candidate; with several joints, that of the joint which it explains most of, and a choice. */
function drawEvidence(target, diagnosis, rank, until) {
  const place = h("div", { class: "chart" });
  const choices = h("div", { class: "choices", role: "group", "aria-label": "Joint of the figure" });
  const drawing = lastAsked(until);
  const show = (joint) => {
    const mine = drawing();
    const answer = get(`/diagnoses/${diagnosis.id}/evidence`, joint ? { rank, joint } : { rank }, mine);
    const paint = (found) => {
      put(choices, found.joints.length > 1 ? found.joints.map((one) => h("button", { type: "button", class: "small", "aria-pressed": String(one === found.joint), onclick: () => show(one) }, one)) : null);
      draw(place, found, mine);
    };
    // Effects far down the list have no figure.
    return drawn(answer, paint, mine, (error) => put(place, h("p", { class: "note" }, error.message)));
  };
  put(target, choices, place);
  show(null);
}

function draw(target, found, until) {
  const { effort_unit: unit, variable, variable_unit: xUnit, residual, spread, fitted } = found;
  const around = (sign) => residual.map((one, index) => one + sign * spread[index]);
  figure(target, {
    title: `Residual of ${found.joint} over ${variable}, and the fitted effect`,
    height: 230,
    x: { name: variable, label: `${variable} (${xUnit})`, words: (raw) => `${number(raw)} ${xUnit}`, values: found.x },
    y: { label: `residual (${unit})`, words: (raw) => `${number(raw)} ${unit}` },
    band: { names: ["mean + spread", "mean − spread"], ends: [around(1), around(-1)] },
    lines: [
      { label: "mean residual", values: residual, stroke: colour("residual"), width: 0, paths: () => null, points: { show: true, size: 6, fill: colour("residual") } },
      { label: "fitted effect", values: fitted, stroke: colour("predicted"), width: 2 },
    ],
  }, until);
  target.append(h("p", { class: "note" }, `The residual is that of the model without the effect; the shaded band is its spread.`));
}

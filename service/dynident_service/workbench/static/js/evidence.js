// The figure behind a ranked effect: the residual over what the effect depends on, and the fitted effect over it.

import { get, lastAsked } from "./api.js";
import { h, put } from "./dom.js";
import { number, percent } from "./format.js";
import { axis, colour, onColours, plot } from "./plots.js";

/** Draw the figure of a candidate; with several joints, that of the joint which it explains most of, and a choice. */
export async function drawEvidence(target, diagnosis, rank, until) {
  const figure = h("div", { class: "chart" });
  const choices = h("div", { class: "choices", role: "group", "aria-label": "Joint of the figure" });
  const drawing = lastAsked(until);

  const show = async (joint) => {
    const mine = drawing();
    const found = await get(`/diagnoses/${diagnosis.id}/evidence`, joint ? { rank, joint } : { rank }, mine);
    if (mine.aborted) return;
    put(choices, found.joints.length > 1 ? found.joints.map((one) => h("button", { type: "button", class: "small", "aria-pressed": String(one === found.joint), onclick: () => show(one) }, one)) : null);
    const draw = () => paint(figure, found, mine);
    onColours(draw, mine);
    draw();
  };
  put(target, choices, figure);
  await show(null);
}

function paint(target, found, until) {
  const { effort_unit: unit, variable, variable_unit: xUnit, residual, spread, fitted } = found;
  const value = (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw)} ${unit}`);
  const hidden = { class: "edge", stroke: "transparent", width: 0, points: { show: false }, value };
  const around = (sign) => residual.map((one, index) => one + sign * spread[index]);
  const label = `${variable} (${xUnit})`;
  const series = [
    { label: variable, value: (_, raw) => (raw === null || raw === undefined ? "–" : `${number(raw)} ${xUnit}`) },
    { ...hidden, label: "mean + spread" },
    { ...hidden, label: "mean − spread" },
    { label: "mean residual", stroke: colour("residual"), width: 0, paths: () => null, points: { show: true, size: 6, fill: colour("residual") }, value },
    { label: "fitted effect", stroke: colour("predicted"), width: 2, points: { show: false }, value },
  ];
  const options = {
    height: 230,
    series,
    scales: { x: { time: false } },
    axes: [axis(label, 2), axis(`residual (${unit})`, 3)],
    bands: [{ series: [1, 2], fill: colour("band-wash") }],
    cursor: { drag: { x: false, y: false } },
    legend: { live: true },
  };
  put(target, h("p", { class: "chart-title" }, `Residual of ${found.joint} over ${variable}, and the fitted effect`));
  plot(target, options, [found.x, around(1), around(-1), residual, fitted], until);
  const words = found.explained === null ? "" : `It takes ${percent(Math.max(0, found.explained), 2)} of the residual's squares on ${found.joint}, on the data that it is fitted to. `;
  target.append(h("p", { class: "note" }, `${words}The residual is that of the model without it; the wash is its spread.`));
}

// What a motion must not touch, in a form: a floor, boxes, and the other fields of the contract's surroundings.

import { h, put, row, table } from "../dom.js";
import { controls, said as saidBy, sorted } from "../request_controls.js";
import { fieldsOf } from "../schema.js";

// These stand above the boxes, the others below them.
const FIRST = ["floor", "clearance"];
const AXES = ["x", "y", "z"];

/** Inputs of surroundings; `given` are those to begin with, and `read()` gives what is stated. */
export async function obstacles(given = {}, prefix = "") {
  const all = controls(await fieldsOf("Surroundings"), { given, pointer: "/surroundings", prefix: `${prefix}surroundings-` });
  const [open, others] = sorted(all, FIRST);
  const fieldsOfAll = (some) => h("div", { class: "fields" }, some.map((one) => one.element));
  const boxes = boxTable(given.boxes ?? []);
  const element = h("fieldset", { "data-pointer": "/surroundings" }, h("legend", {}, "Obstacles"),
    h("p", { class: "note" }, "The motion avoids what is stated here, in m in the base frame. A table top is a box."),
    fieldsOfAll(open), boxes.element,
    h("details", { class: "more" }, h("summary", {}, "More about obstacles"), fieldsOfAll(others)));
  return { element, read: () => ({ surroundings: { ...given, ...saidBy(all), boxes: boxes.read() } }) };
}

function boxTable(given) {
  const rows = given.map((box) => ({ ...box }));
  const place = h("div");
  const input = (box, index, key, axis) => h("div", { "data-pointer": `/surroundings/boxes/${index}/${key}${axis === null ? "" : `/${axis}`}` }, axis === null
    ? h("input", { maxlength: 200, value: box.name, "aria-label": `Name of box ${index + 1}`, oninput: (event) => { box.name = event.target.value; } })
    : h("input", { type: "number", step: "any", class: "limit", value: box[key][axis] ?? "", "aria-label": `${key === "center" ? "Centre" : "Edge"} ${AXES[axis]} of box ${index + 1}`, oninput: (event) => { box[key] = box[key].with(axis, event.target.value === "" ? null : Number(event.target.value)); } }));
  const show = () => put(place, rows.length ? table("Boxes", ["box", ...AXES.map((axis) => `centre ${axis} (m)`), ...AXES.map((axis) => `edge ${axis} (m)`), ""], rows.map((box, index) => row([
    input(box, index, "name", null),
    ...["center", "size"].flatMap((key) => AXES.map((_, axis) => input(box, index, key, axis))),
    h("button", { type: "button", class: "small", "aria-label": `Remove box ${index + 1}`, onclick: () => { rows.splice(index, 1); show(); } }, "Remove"),
  ])), { id: "boxes-table" }) : null);
  const add = () => {
    rows.push({ name: `box ${rows.length + 1}`, center: [null, null, null], size: [null, null, null] });
    show();
    place.querySelector("tbody tr:last-child input.limit").focus();
  };
  show();
  return { element: h("div", {}, place, h("p", {}, h("button", { type: "button", id: "add-box", onclick: add }, "Add a box"))), read: () => rows };
}

// A robot from its description, with the drive gains that turn currents into torques.

import { post } from "./api.js";
import { field, h, put, row, select, table } from "./dom.js";
import { dropZone } from "./drop_zone.js";
import { clearForm, showInForm } from "./problem.js";

const FORMATS = [["urdf", "URDF"], ["modified_dh", "modified Denavit-Hartenberg table (JSON)"]];
const MOVING = new Set(["revolute", "continuous", "prismatic"]);

/** A form that makes a robot; `onMade` is given it. */
export function robotForm(onMade, open) {
  const name = h("input", { name: "name", id: "robot-name", required: true, maxlength: 200 });
  const content = h("textarea", { id: "robot-description", rows: 8, required: true, spellcheck: "false", oninput: () => described() });
  const format = select(FORMATS, "urdf", () => described(), { id: "robot-format" });
  const gains = h("div");
  const said = h("div");
  const submit = h("button", { class: "main", id: "create-robot" }, "Create the robot");

  const described = () => put(gains, gainFields(jointsIn(content.value, format.value)));
  const read = async ([file]) => {
    content.value = await file.text();
    format.value = content.value.trimStart().startsWith("<") ? "urdf" : "modified_dh";
    name.value ||= file.name.replace(/\.[^.]*$/, "");
    described();
  };
  const send = async (event) => {
    event.preventDefault();
    clearForm(form, said);
    submit.disabled = true;
    try {
      const description = { format: format.value, content: content.value };
      onMade(await post("/robots", { name: name.value, description, drives: drivesIn(gains) }));
    } catch (error) {
      showInForm(form, said, error);
    }
    submit.disabled = false;
  };
  const form = h(
    "form",
    { onsubmit: send },
    dropZone("Drop the robot's file here, or choose it:", { accept: ".urdf,.xml,.json", id: "robot-file" }, read),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" }), field("Format", format, { pointer: "/description/format" })),
    field("Description", content, { pointer: "/description", hint: "Paste it, or drop the file above.", wide: true }),
    gains,
    said,
    h("p", {}, submit),
  );
  return h("details", { open, id: "new-robot" }, h("summary", {}, "A new robot"), form);
}

/** Fields for drive gains; `joints` are [{ name, type, gain }]. */
export function gainFields(joints) {
  if (!joints.length) return null;
  const rows = joints.map((joint) => {
    const unit = joint.type === "prismatic" ? "N/A" : "N m/A";
    const input = h("input", { type: "number", step: "any", "data-gain-of": joint.name, value: joint.gain ?? "", "aria-label": `Drive gain of ${joint.name} in ${unit}` });
    return row([joint.name, joint.type, h("div", { "data-pointer": `/drives/${joint.name}` }, input, ` ${unit}`)]);
  });
  return [
    table("Drive gains: torque = drive gain × current [12.17]", ["joint", "type", "drive gain"], rows, { class: "narrow" }),
    h("p", { class: "note" }, "Needed only where recordings have currents instead of torques."),
  ];
}

/** The drives that are filled in, as the API wants them. */
export function drivesIn(element) {
  const filled = [...element.querySelectorAll("[data-gain-of]")].filter((input) => input.value !== "");
  return Object.fromEntries(filled.map((input) => [input.dataset.gainOf, { drive_gain: Number(input.value) }]));
}

/** The moving joints that a description names, as far as the page can tell; the service has the last word. */
function jointsIn(text, format) {
  if (format === "urdf") {
    const document = new DOMParser().parseFromString(text, "application/xml");
    const joints = [...document.querySelectorAll("robot > joint")];
    return joints.filter((one) => MOVING.has(one.getAttribute("type"))).map((one) => ({ name: one.getAttribute("name"), type: one.getAttribute("type") === "prismatic" ? "prismatic" : "revolute" }));
  }
  try {
    const table = JSON.parse(text);
    const rows = Array.isArray(table) ? table : (table.joints ?? []);
    return rows.map((one, index) => ({ name: one.name ?? `joint${index + 1}`, type: one.sigma === 1 ? "prismatic" : "revolute" }));
  } catch {
    return [];
  }
}

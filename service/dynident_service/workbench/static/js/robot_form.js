// Form of a robot: description, drive gains, locked joints, gravity.

import { post } from "./api.js";
import { field, h, put, select } from "./dom.js";
import { dropZone } from "./drop_zone.js";
import { sending } from "./problem.js";
import { factsIn, gainFields, placeFields } from "./recordings/robot_facts.js";

const MOVING = new Set(["revolute", "continuous", "prismatic"]);

/** A form that makes a robot from a description in one of the `formats`; `onMade` is given it. */
export function robotForm(formats, onMade, open) {
  const name = h("input", { name: "name", id: "robot-name", required: true, maxlength: 200 });
  const content = h("textarea", { id: "robot-description", rows: 8, required: true, spellcheck: "false", oninput: () => { if (content.value.trim()) format.value = formatOf(content.value); described(); } });
  const format = select(formats, "urdf", () => described(), { id: "robot-format" });
  // Folded: most robots need neither, and the button below stays in sight.
  const currents = h("details", { hidden: true }, h("summary", {}, "Recordings will have currents: drive gains"));
  const places = h("details", { hidden: true }, h("summary", {}, "Joints are locked, or the base is not upright"));
  const said = h("div");
  const submit = h("button", { class: "main", id: "create-robot" }, "Create the robot");

  const [gains, placed] = [h("div"), h("div")];
  currents.append(gains);
  places.append(placed);
  let named = ""; // what the name was filled in with, and may be replaced by
  const callIt = (words) => {
    if (!words || (name.value && name.value !== named)) return;
    name.value = named = words.slice(0, 200);
  };
  const described = () => {
    callIt(ownName(content.value, format.value));
    const joints = jointsIn(content.value, format.value);
    const before = h("div");
    before.append(...gains.childNodes, ...placed.childNodes);
    put(gains, gainFields(joints));
    put(placed, placeFields(joints));
    currents.hidden = places.hidden = !joints.length;
    keepTyped(before, form);
  };
  const read = async ([file]) => {
    content.value = await file.text();
    format.value = formatOf(content.value);
    callIt(file.name.replace(/\.[^.]*$/, ""));
    described();
  };
  const send = sending(submit, said, async (form) => {
    const description = { format: format.value, content: content.value };
    onMade(await post("/robots", { name: name.value, description, ...factsIn(form) }));
  });
  const form = h("form", { onsubmit: send },
    dropZone("Drop the robot's file here, or choose it:", { accept: ".urdf,.xml,.json,.txt,.csv", id: "robot-file" }, read),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" }), field("Format", format, { pointer: "/description/format" })),
    field("Description", content, { pointer: "/description", hint: "Paste it, or drop the file above.", wide: true }),
    currents,
    places,
    said,
    h("p", {}, submit),
  );
  return h("details", { open, id: "new-robot" }, h("summary", {}, "A new robot"), form);
}

/** The format that a text is in. */
function formatOf(text) {
  const start = text.trimStart();
  if (start.startsWith("<")) return xml(text).documentElement.tagName === "mujoco" ? "mjcf" : "urdf";
  return start.startsWith("{") || start.startsWith("[") ? "modified_dh" : "dh";
}

/** The name that a description gives its robot; "" where it gives none. */
function ownName(text, format) {
  if (format === "urdf" || format === "mjcf") return xml(text).documentElement.getAttribute(format === "urdf" ? "name" : "model") ?? "";
  if (format === "dh") return "";
  try {
    return JSON.parse(text).name ?? "";
  } catch {
    return "";
  }
}

/** What was typed for joints that are still there stays. */
function keepTyped(before, form) {
  for (const kind of ["gainOf", "lockedAt", "locks", "gravity"]) {
    const name = kind.replace(/[A-Z]/g, (letter) => `-${letter.toLowerCase()}`);
    const old = new Map([...before.querySelectorAll(`[data-${name}]`)].map((one) => [one.dataset[kind], one]));
    for (const one of form.querySelectorAll(`[data-${name}]`)) {
      const typed = old.get(one.dataset[kind]);
      if (!typed) continue;
      if (one.type === "checkbox") one.checked = typed.checked;
      else [one.value, one.disabled] = [typed.value, typed.disabled];
    }
  }
}

const xml = (text) => new DOMParser().parseFromString(text, "application/xml");

/** The moving joints that a description names, as far as the page can tell; the service has the last word. */
function jointsIn(text, format) {
  if (format === "urdf") {
    const joints = [...xml(text).querySelectorAll("robot > joint")];
    return joints.filter((one) => MOVING.has(one.getAttribute("type"))).map((one) => ({ name: one.getAttribute("name"), type: one.getAttribute("type") === "prismatic" ? "prismatic" : "revolute" }));
  }
  if (format === "mjcf") {
    const joints = [...xml(text).querySelectorAll("worldbody joint[name]")];
    return joints.map((one) => ({ name: one.getAttribute("name"), type: one.getAttribute("type") === "slide" ? "prismatic" : "revolute" }));
  }
  if (format === "dh") return [];
  try {
    const table = JSON.parse(text);
    const rows = Array.isArray(table) ? table : (table.joints ?? []);
    return rows.map((one, index) => ({ name: one.name ?? `joint${index + 1}`, type: one.sigma === 1 ? "prismatic" : "revolute" }));
  } catch {
    return [];
  }
}

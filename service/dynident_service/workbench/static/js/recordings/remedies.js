// Remedies of findings: said in the page's words instead of the contract's, and done by buttons.

import { post } from "../api.js";
import { announce, h } from "../dom.js";
import { number } from "../format.js";
import { editInWords } from "./revision_edits.js";

const OF_ROBOT = new Set(["gravity", "locked_joints"]);
const OF_RECORDING = new Set(["columns", "units", "signs", "scale", "skip", "rate", "role", "windows", "zeros"]);

/** A sentence whose remedies are written as what is to be done on this page. */
export function inPageWords(sentence, remedies, joints = []) {
  return (remedies ?? []).reduce((text, one) => (one.text ? text.replaceAll(one.text, () => remedyInWords(one, joints)) : text), sentence);
}

// What is done by a control of this page whatever the value.
const CONTROLS = {
  accept: "that it is, by the button “It is right: use it anyway”",
  drives: "the fields “Drive gains”",
  contacts: "the robot's fields of its base",
  meshes: "over HTTP or on the command line, not on this page",
  assume_floor: "“Assume floor”, under “More about obstacles”",
  identification_id: "“Torque predicted by”",
};

function remedyInWords({ field, value }, joints) {
  if (field in CONTROLS) return CONTROLS[field];
  const open = /null|…/.test(JSON.stringify(value ?? null));
  if (field === "columns" && open) return `the table of columns below (${Object.keys(value).map((one) => editInWords({ units: { [one]: "" } }, joints).replace(/ in $/, "")).join(", ")})`;
  if (field === "rate" && value === null) return "the field “Rows per second”";
  if (open) return `“${field.replaceAll("_", " ")}”`;
  if (field === "gravity") return `gravity (${value.map((one) => number(one)).join(", ")}) m/s²`;
  if (field === "locked_joints") return `“Joints that are locked” (${Object.entries(value).map(([name, at]) => (at ? `${name} at ${number(at)}` : name)).join(", ")})`;
  return `“${editInWords({ [field]: value }, joints)}”`;
}

/** What a button may do for a finding: { edit } of the recording, { facts } of the robot; null where only the user knows. */
export function actionOf({ apply, remedies }) {
  if (apply) return { edit: apply };
  const known = (remedies ?? []).find(({ field, value }) => (OF_ROBOT.has(field) || OF_RECORDING.has(field)) && !/null|…/.test(JSON.stringify(value ?? null)));
  if (!known) return null;
  return OF_ROBOT.has(known.field) ? { facts: known } : { edit: { [known.field]: known.value } };
}

/** A button that makes a robot as a remedy says; `onRobot` is given it. */
export function robotButton(remedy, robot, onRobot, onError) {
  const make = async () => {
    const { request, id, name } = robot;
    const locks = remedy.field === "locked_joints";
    const value = locks ? { ...request.locked_joints, ...remedy.value } : remedy.value;
    // A joint that is locked has no drive.
    const drives = Object.fromEntries(Object.entries(request.drives ?? {}).filter(([joint]) => !locks || !(joint in value)));
    try {
      onRobot(await post("/robots", { ...request, drives, meshes_of: id, name: `${name} as it is mounted`.slice(0, 200), [remedy.field]: value }));
      announce("The new robot is chosen");
    } catch (error) {
      onError(error);
    }
  };
  return h("button", { type: "button", class: "small apply", onclick: make }, `Make a robot with ${remedyInWords(remedy, [])}`);
}

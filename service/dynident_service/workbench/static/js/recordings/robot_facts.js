// Fields that a recording needs of the robot: drive gains, locked joints, gravity.

import { post } from "../api.js";
import { announce, h, row, table } from "../dom.js";
import { clearForm, showInForm } from "../problem.js";

const AXES = ["x", "y", "z"];

/** Fields for drive gains; `joints` are [{ name, type, drive_gain }]. */
export function gainFields(joints) {
  if (!joints.length) return null;
  const rows = joints.map((joint) => {
    const unit = joint.type === "prismatic" ? "N/A" : "N m/A";
    const input = h("input", { type: "number", step: "any", "data-gain-of": joint.name, value: joint.drive_gain ?? "", "aria-label": `Drive gain of ${joint.name} in ${unit}`, onpaste: fillRow });
    return row([joint.name, joint.type, h("div", { "data-pointer": `/drives/${joint.name}` }, input, ` ${unit}`)]);
  });
  return [
    table("Drive gains: torque = drive gain × current [12.17]", ["joint", "type", "drive gain"], rows, { class: "narrow" }),
    h("p", { class: "note" }, "Needed only where recordings have currents instead of torques, or only commands of servos (then in N m/rad). A pasted row of numbers fills the fields from here on."),
  ];
}

/** Several numbers that are pasted into a field go into it and those after it. */
function fillRow(event) {
  const numbers = event.clipboardData.getData("text").split(/[\s,;[\]]+/).filter(Boolean);
  if (numbers.length < 2 || numbers.some((one) => Number.isNaN(Number(one)))) return;
  event.preventDefault();
  const all = [...event.target.closest("table").querySelectorAll("[data-gain-of]")];
  const first = all.indexOf(event.target);
  all.slice(first, first + numbers.length).forEach((input, index) => {
    input.value = numbers[index];
    input.dispatchEvent(new Event("input", { bubbles: true }));
  });
}

/** Fields for joints that are held where they are, and for gravity; `joints` are [{ name, type, locked }]. */
export function placeFields(joints, gravity = null) {
  if (!joints.length) return null;
  const rows = joints.map((joint) => {
    const unit = joint.type === "prismatic" ? "m" : "rad";
    const place = h("input", { type: "number", step: "any", class: "short", "data-locked-at": joint.name, value: joint.locked ?? 0, disabled: joint.locked === undefined, "aria-label": `Where ${joint.name} is locked, in ${unit}` });
    const box = h("input", { type: "checkbox", "data-locks": joint.name, checked: joint.locked !== undefined, "aria-label": `${joint.name} is locked`, onchange: () => { place.disabled = !box.checked; } });
    return row([joint.name, box, h("div", { "data-pointer": `/locked_joints/${joint.name}` }, place, ` ${unit}`)]);
  });
  const fields = AXES.map((axis, index) => h("label", {}, `${axis} `, h("input", { type: "number", step: "any", class: "short", "data-gravity": axis, value: gravity?.[index] ?? "", placeholder: index === 2 ? "−9.81" : "0", oninput: zerosBeside })));
  return [
    table("Joints that are locked: no recording has columns for them", ["joint", "locked", "at"], rows, { class: "narrow" }),
    h("fieldset", { class: "actions", "data-pointer": "/gravity" }, h("legend", {}, "Gravity in the frame of the base (m/s²)"), fields, h("span", { class: "note" }, "empty: 9.81 downwards along −z. A robot on a wall or a ceiling has another.")),
  ];
}

/** Once one component is stated, the others are numbers, too: what a placeholder shows would not be sent. */
function zerosBeside(event) {
  for (const input of event.target.closest("fieldset").querySelectorAll("[data-gravity]")) if (input.value === "") input.value = "0";
}

/** What is filled in, as a robot's request takes it: { drives, locked_joints, gravity }. */
export function factsIn(element) {
  const filled = [...element.querySelectorAll("[data-gain-of]")].filter((input) => input.value !== "");
  const locked = [...element.querySelectorAll("[data-locks]:checked")].map((box) => box.dataset.locks);
  const placeOf = (joint) => Number([...element.querySelectorAll("[data-locked-at]")].find((one) => one.dataset.lockedAt === joint).value);
  const gravity = [...element.querySelectorAll("[data-gravity]")].map((one) => one.value);
  return {
    drives: Object.fromEntries(filled.map((input) => [input.dataset.gainOf, { drive_gain: Number(input.value) }])),
    locked_joints: Object.fromEntries(locked.map((joint) => [joint, placeOf(joint)])),
    gravity: gravity.some(Boolean) ? gravity.map(Number) : null,
  };
}

/** Drive gains that turn currents into torques; `onRobot` is given a robot that has them. */
export function drivesOf(robot, onRobot) {
  const body = h("div", {}, gainFields(robot.joints));
  return robotWith(body, () => withDrives(robot, "with drive gains", factsIn(body).drives), "Make a robot with these drive gains", onRobot);
}

/** The request of a robot with other drive gains. */
export function withDrives({ id, name, request }, suffix, drives) {
  return { ...request, meshes_of: id, name: `${name} ${suffix}`.slice(0, 200), drives: merged(request.drives, drives) };
}

/** Locked joints and gravity; `onRobot` is given a robot that is so. */
export function placesOf(robot, onRobot) {
  const { request } = robot;
  const locked = request.locked_joints ?? {};
  const others = Object.keys(locked).filter((name) => !robot.joints.some((one) => one.name === name));
  // The base of a robot that floats moves by joints of its own, which no description has.
  const own = robot.joints.filter((one) => robot.base === "fixed" || !one.name.startsWith("base_"));
  const joints = [...own, ...others.map((name) => ({ name, type: "revolute" }))];
  const body = h("div", {}, placeFields(joints.map((one) => ({ ...one, locked: locked[one.name] })), request.gravity));
  const wanted = () => {
    const { locked_joints, gravity } = factsIn(body);
    return { ...withDrives(robot, "as it is mounted", {}), locked_joints, gravity };
  };
  return robotWith(body, wanted, "Make a robot with these settings", onRobot);
}

/** The fields with a button that makes a robot; not a form, for it may stand in one. */
export function robotWith(body, request, text, onRobot) {
  const said = h("div");
  const send = async () => {
    clearForm(element, said);
    try {
      onRobot(await post("/robots", request()));
      announce("The new robot is chosen");
    } catch (error) {
      showInForm(element, said, error);
    }
  };
  const entered = (event) => {
    if (event.key !== "Enter" || !event.target.matches("input")) return;
    event.preventDefault();
    send();
  };
  const element = h("div", { onkeydown: entered }, body, said, h("p", { class: "actions" }, h("button", { type: "button", onclick: send }, text), h("span", { class: "note" }, "Stored recordings keep the robot that they were read with.")));
  return element;
}

function merged(before, now) {
  const names = new Set([...Object.keys(before ?? {}), ...Object.keys(now)]);
  return Object.fromEntries([...names].map((name) => [name, { ...before?.[name], ...now[name] }]));
}

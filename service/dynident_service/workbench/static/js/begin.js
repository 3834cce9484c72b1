// How to come to a model: a robot, its measurements, an identification.

import { get } from "./api.js";
import { pictureOf } from "./arm/picture.js";
import { h, put } from "./dom.js";
import { driveGainsPanel } from "./drive_gains.js";
import { counted, number } from "./format.js";
import { identificationForm } from "./identification_form.js";
import { remember } from "./location.js";
import { measurementForm, measurementsTable } from "./measurement_form.js";
import { robotForm } from "./robot_form.js";
import { choicesOf, fieldsOf } from "./schema.js";

/** Three steps on one page; each opens once the one before it is done. */
export async function beginPage(target, wanted, signal) {
  document.title = "New model: dynident";
  const [{ items: robots }, description, metadata] = await Promise.all([get("/robots", { limit: 100 }, signal), fieldsOf("Description"), fieldsOf("MeasurementMetadata")]);
  const steps = { robot: h("div"), measurements: h("div"), identification: h("div") };
  const state = { robots, robot: robots.find((one) => one.id === wanted.robot) ?? robots[0] ?? null, measurements: [] };
  const forms = h("div");

  const choose = async (robot) => {
    state.robot = robot;
    // What is stored belongs to the robot before; what is not yet sent stays for this one.
    for (const done of forms.querySelectorAll(":scope > details")) done.remove();
    if (robot && !robots.includes(robot)) robots.unshift(robot);
    if (robot) remember({ view: "new", robot: robot.id });
    showRobots();
    await readMeasurements();
  };
  const readMeasurements = async () => {
    const { robot } = state;
    if (!robot) {
      put(steps.measurements, h("p", { class: "note" }, "First choose or create a robot."));
      put(steps.identification, h("p", { class: "note" }, "First upload a measurement."));
      return;
    }
    // Steps of the robot before would be taken away under somebody's hands, and until then act on it.
    for (const place of [steps.measurements, steps.identification]) put(place, h("p", { class: "note" }, `Loading the data of ${robot.name} …`));
    state.measurements = (await get("/measurements", { robot_id: robot.id, limit: 200 }, signal)).items;
    if (robot !== state.robot || signal.aborted) return;
    state.form = await identificationForm(robot);
    state.gains = driveGainsPanel(robot, choose, signal);
    put(steps.measurements, measurementsTable(state.measurements), measurementForm(robot, { forms, metadata, chosen: () => state.robot, onStored: stored, onRobot: choose, count: () => state.measurements.length, stored: () => state.measurements }), state.gains.element);
    showIdentification();
  };
  const stored = (measurement) => {
    if (measurement.robot_id !== state.robot?.id) return;
    state.measurements.unshift(measurement);
    const list = steps.measurements.querySelector(".stored");
    list.replaceWith(measurementsTable(state.measurements));
    showIdentification();
  };
  const showIdentification = () => {
    state.form.update(state.measurements);
    state.gains.update(state.measurements);
    state.gains.element.hidden = state.measurements.length < 2;
    if (state.form.element.isConnected) return;
    put(steps.identification, state.measurements.length ? state.form.element : h("p", { class: "note" }, "First upload a measurement."));
  };
  const showRobots = () => put(steps.robot, robotChoice(state, choose), state.robot && pictureOf(state.robot, signal), robotForm(choicesOf(description.format), choose, robots.length === 0));

  put(
    target,
    h("h1", {}, robots.length ? "A new model" : "Begin with a robot"),
    h("p", {}, "dynident identifies the dynamic parameters from a description of the robot and recordings of its motion, and names the physical effects that the model lacks."),
    step("1. Robot", steps.robot),
    step("2. Measurements", steps.measurements),
    step("3. Identification", steps.identification),
  );
  showRobots();
  await readMeasurements();
}

function step(title, body) {
  return h("section", { class: "step", "aria-label": title }, h("h2", {}, title), body);
}

function robotChoice(state, choose) {
  if (!state.robots.length) return null;
  const radios = state.robots.map((robot) =>
    h("label", { class: "pick-one" },
      h("input", { type: "radio", name: "robot", value: robot.id, checked: robot === state.robot, onchange: () => choose(robot) }),
      h("strong", {}, ` ${robot.name} `),
      h("span", { class: "note" }, `${counted(robot.joints.length, "joint")}, ${counted(robot.base_parameters.count, "base parameter")}${gains(robot)}`),
    ),
  );
  return h("fieldset", { class: "list-of-choices" }, h("legend", {}, "Existing robots"), radios);
}

function gains(robot) {
  const known = robot.joints.filter((joint) => joint.drive_gain !== null);
  const units = [...new Set(known.map((joint) => (joint.type === "revolute" ? "N m/A" : "N/A")))].join(" or ");
  return known.length ? `, drive gains ${known.map((joint) => number(joint.drive_gain, 4)).join(", ")} ${units}` : "";
}

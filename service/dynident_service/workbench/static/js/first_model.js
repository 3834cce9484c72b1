// Page of the first steps: create a robot, upload measurements, identify.

import { get, post } from "./api.js";
import { pictureOf } from "./arm/picture.js";
import { field, h, put, select } from "./dom.js";
import { driveGainsPanel } from "./drive_gains.js";
import { counted, number } from "./format.js";
import { awaited } from "./jobs.js";
import { identificationForm } from "./identification_form.js";
import { remember } from "./page_address.js";
import { measurementForm, measurementsTable } from "./measurement_form.js";
import { pressed, problemBox } from "./problem.js";
import { robotForm } from "./robot_form.js";
import { choicesOf, fieldsOf } from "./schema.js";

/** What acts in the drives of a virtual robot of which nothing else is said. */
export const USUAL_DRIVES = ["rotor_inertia", "coulomb", "viscous"];
// A virtual arm with an effect to be found; both motions are drawn at random.
const SAMPLE = {
  robot: "scara",
  motion: { trajectory: { duration: 10, sampling_rate: 200 }, effects: [...USUAL_DRIVES, "stribeck"].map((effect) => ({ effect, ...(effect === "stribeck" ? { joints: ["elbow"] } : {}) })) },
  runs: [{ name: "sample run 1", role: "identification", seed: 1 }, { name: "sample run 2", role: "validation", seed: 2 }],
};

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
      put(steps.identification, h("p", { class: "note" }, "First upload a recording."));
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
    put(steps.identification, state.measurements.length ? state.form.element : h("p", { class: "note" }, "First upload a recording."));
  };
  const showRobots = () => put(steps.robot, robotChoice(state, choose), state.robot && pictureOf(state.robot, signal), knownRobots(choose, robots.length === 0, signal), robotForm(choicesOf(description.format), choose, robots.length === 0));

  put(
    target,
    h("h1", {}, robots.length ? "A new model" : "Begin with a robot"),
    h("p", {}, "dynident identifies the dynamic parameters from a description of the robot and recordings of its motion, and names the physical effects that the model lacks."),
    step("1. Robot", steps.robot),
    step("2. Recordings", steps.measurements),
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

/** A robot without a file: a well-known arm, for an empty service with recordings of a virtual one to try with. */
function knownRobots(choose, empty, signal) {
  const said = h("div");
  const place = h("div");
  const fill = async () => {
    const { items } = await get("/known-robots", {}, signal);
    const about = h("span", { class: "note" });
    const tell = (name) => put(about, items.find((one) => one.name === name).source);
    const arm = select(items.map((one) => [one.name, one.name]), items[0].name, tell, { id: "known-robot" });
    tell(items[0].name);
    const made = (name) => post("/robots", { name, description: items.find((one) => one.name === name).description });
    const create = h("button", { type: "button", id: "create-known", onclick: () => pressed(create, async () => choose(await made(arm.value)), (error) => put(said, problemBox(error)), signal) }, "Use this arm");
    const sample = h("button", { type: "button", id: "sample-data", onclick: () => pressed(sample, async () => {
      const robot = await made(SAMPLE.robot);
      for (const one of SAMPLE.runs) await awaited("/simulations", await post("/simulations", { robot_id: robot.id, ...SAMPLE.motion, ...one }), `Simulating ${one.name}`, said, signal);
      await choose(robot);
    }, (error) => put(said, problemBox(error)), signal) }, "Try it with sample data");
    put(place, h("p", { class: "actions" }, sample, h("span", { class: "note" }, `two simulated recordings of ${SAMPLE.robot}, with a hidden effect`)),
      h("div", { class: "bar-of-fields" }, field("Well-known arm", arm), create, about), said);
  };
  return h("details", { open: empty, id: "known-robots", ontoggle: (event) => { if (event.target.open && !place.childElementCount) fill().catch((error) => put(place, problemBox(error))); } },
    h("summary", {}, "Sample data, or a well-known arm"), place);
}

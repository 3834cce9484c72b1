// Drive gains from runs without and with a load of known mass, and other loads weighed with them.

import { get, post } from "./api.js";
import { announce, field, h, numeric, put, right, row, select, table } from "./dom.js";
import { moment, number, quantity } from "./format.js";
import { computed, progressBar } from "./jobs.js";
import { clearForm, pressed, problemBox, showInForm } from "./problem.js";

const USES = [["", "leave out"], ["unloaded", "without the load"], ["loaded", "with the known load"], ["weigh", "weigh its load"], ["weigh_unloaded", "without, for weighing"]];

/** A form that identifies the drive gains of a robot; `update(measurements)` keeps what has been chosen. */
export function driveGainsPanel(robot, onRobot, signal) {
  const uses = new Map(); // measurement's id -> its select
  const places = h("div", { class: "list-of-choices" });
  const mass = h("input", { id: "known-mass", type: "number", step: "any", min: 0, placeholder: "as stated with it" });
  const centre = h("input", { id: "known-centre", placeholder: "not known" });
  const said = h("div");
  const result = h("div", { id: "gains-found" });
  const submit = h("button", { class: "main", id: "identify-gains" }, "Identify the drive gains");

  const chosen = (use) => [...uses].filter(([, { control }]) => control.value === use).map(([id]) => id);
  const update = (measurements) =>
    put(places, measurements.map((one) => {
      if (!uses.has(one.id)) uses.set(one.id, line(one));
      return uses.get(one.id).element;
    }));
  const request = () => {
    const named = Object.fromEntries(USES.filter(([use]) => use).map(([use]) => [use, chosen(use)]));
    for (const [use, ids] of Object.entries(named)) ids.forEach((id, index) => { uses.get(id).element.dataset.pointer = `/${use}/${index}`; });
    return {
      robot_id: robot.id,
      unloaded: named.unloaded,
      loaded: named.loaded,
      mass: mass.value ? Number(mass.value) : null,
      centre: centre.value.trim() ? numbersIn(centre.value) : null,
      weigh: named.weigh.length ? named.weigh : null,
      weigh_unloaded: named.weigh_unloaded.length ? named.weigh_unloaded : null,
    };
  };
  const send = async (event) => {
    event.preventDefault();
    clearForm(form, said);
    const body = request();
    if (!body.unloaded.length || !body.loaded.length) {
      put(said, h("p", { class: "complaint", role: "alert" }, "Choose at least one measurement without the load, and one of the same motion with it."));
      return;
    }
    await pressed(submit, async () => {
      await wait(await post("/drive_gains", body, { signal }));
      announce("The drive gains are there");
    }, (error) => {
      put(result);
      showInForm(form, said, error);
    }, signal);
  };
  const wait = async (made) => {
    const bar = progressBar(made.job_id, "drive gains");
    put(result, bar.element);
    put(result, found(robot, await computed("/drive_gains", made, bar.update, signal), onRobot));
  };
  const form = h(
    "form",
    { onsubmit: send },
    h("p", { class: "note" }, "The same motion without and with a load whose mass is known tells what torque a current makes: the drive gains, by total least squares."),
    h("fieldset", {}, h("legend", {}, "Measurements"), places),
    h("div", { class: "fields" }, field("Mass of the known load (kg)", mass, { pointer: "/mass" }), field("Its centre x, y, z (m)", centre, { pointer: "/centre", hint: "In the last joint's frame." })),
    said,
    h("p", {}, submit),
  );
  const element = h("details", { id: "drive-gains" }, h("summary", {}, "Drive gains from a known load"), form, result);
  newest(robot, wait, element, signal);
  return { element, update };
}

function line(measurement) {
  const control = select(USES, measurement.role === "payload" ? "loaded" : "", null, { "aria-label": `Load of ${measurement.name}` });
  const load = measurement.request.payload?.mass;
  return { control, element: h("div", { class: "pick-one" }, control, ` ${measurement.name} `, load ? h("span", { class: "note" }, quantity(load, "kg")) : null) };
}

/** Show what is known already, or is being computed. */
async function newest(robot, wait, element, signal) {
  try {
    const { items } = await get("/drive_gains", { robot_id: robot.id, limit: 20 }, signal);
    const known = items.find((one) => one.status !== "failed" && one.status !== "cancelled");
    if (!known) return;
    element.open = true;
    await wait(known);
  } catch (error) {
    if (!signal.aborted) element.append(problemBox(error));
  }
}

function found(robot, one, onRobot) {
  const { gains, loads, warnings } = one.result;
  const reach = ([low, high]) => (low === null || high === null ? null : (high - low) / 2);
  const rows = gains.map((gain) => row([
    gain.joint,
    numeric(number(gain.stated, 4), gain.stated),
    numeric(number(gain.drive_gain, 4), gain.drive_gain),
    numeric(number(reach(gain.interval), 2), reach(gain.interval)),
    gain.unit === "-" ? "factor" : gain.unit,
    h("span", { class: gain.identifiable ? "mark ok" : "mark error" }, gain.identifiable ? "✓ yes" : "✕ no"),
  ]));
  const head = ["joint", right("stated"), right("identified"), right("± 95 %"), "unit", "identifiable"];
  return [
    warnings.length ? h("div", { class: "box warning" }, h("ul", {}, warnings.map((text) => h("li", {}, text)))) : null,
    table(`Drive gains, ${moment(one.created_at)}`, head, rows, { id: "gains-table", class: "narrow" }),
    loads.length ? loadsTable(loads) : null,
    gains.every((gain) => gain.unit !== "-") ? takeOver(robot, gains, onRobot) : null,
  ];
}

function loadsTable(loads) {
  const rows = loads.map((one) => row([
    one.name,
    numeric(quantity(one.mass, "kg"), one.mass),
    `${number(one.interval[0])} to ${quantity(one.interval[1], "kg")}`,
    numeric(quantity(one.from_gains, "kg", 2), one.from_gains),
    one.identifiable ? "yes" : "no",
  ]));
  return table("Loads weighed with these gains", ["measurement", right("mass"), "95 % interval", right("σ from the gains"), "shows at all"], rows, { id: "loads-table", class: "narrow" });
}

function takeOver(robot, gains, onRobot) {
  const said = h("div");
  const button = h("button", { type: "button", onclick: () => make() }, "Make a robot with these drive gains");
  const make = async () => {
    await pressed(button, async () => {
      const drives = Object.fromEntries(gains.map((gain) => [gain.joint, { drive_gain: gain.drive_gain }]));
      onRobot(await post("/robots", { ...robot.request, meshes_of: robot.id, name: `${robot.name} with identified drive gains`.slice(0, 200), drives: { ...robot.request.drives, ...drives } }));
      announce("The robot with these drive gains is chosen");
    }, (error) => put(said, problemBox(error)));
  };
  return [h("p", { class: "actions" }, button, h("span", { class: "note" }, "Then upload the recordings for it: stored ones keep the gains that they were read with.")), said];
}

/** "0, 0, 0.1" as numbers; what is no number is left for the service to complain of. */
function numbersIn(text) {
  return text.split(/[,;\s]+/).filter(Boolean).map((one) => (Number.isNaN(Number(one)) ? one : Number(one)));
}

// Panel of drive gains from runs with a known load, and of loads weighed with them.

import { post } from "./api.js";
import { announce, field, h, put } from "./dom.js";
import { moment, quantity } from "./format.js";
import { awaited, newestOf } from "./jobs.js";
import { complaint, orSay, sending } from "./problem.js";
import { robotWith, withDrives } from "./recordings/robot_facts.js";
import { shownTable } from "./tables.js";
import { usesOf } from "./measurement_uses.js";

const USES = [["", "leave out"], ["unloaded", "without the load"], ["loaded", "with the known load"], ["weigh", "weigh its load"], ["weigh_unloaded", "without, for weighing"]];

/** A form that identifies the drive gains of a robot; `update(measurements)` keeps what has been chosen. */
export function driveGainsPanel(robot, onRobot, signal) {
  const uses = usesOf(USES, { usual: (one) => (one.role === "payload" ? "loaded" : ""), called: "Load", about: (one) => quantity(one.request.payload?.mass, "kg").replace("–", "") });
  const mass = h("input", { id: "known-mass", type: "number", step: "any", min: 0, placeholder: "as stated with the recording" });
  const centre = h("input", { id: "known-centre", placeholder: "unknown" });
  const said = h("div");
  const result = h("div", { id: "gains-found" });
  const submit = h("button", { class: "main", id: "identify-gains" }, "Identify the drive gains");

  const request = () => {
    const named = Object.fromEntries(USES.filter(([use]) => use).map(([use]) => [use, uses.chosen(use)]));
    for (const [use, ids] of Object.entries(named)) ids.forEach((id, index) => { uses.lineOf(id).dataset.pointer = `/${use}/${index}`; });
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
  const send = sending(submit, said, async () => {
    const body = request();
    if (!body.unloaded.length || !body.loaded.length) return void put(said, complaint("Choose at least one recording without the load, and one of the same motion with it."));
    put(result);
    await wait(await post("/drive_gains", body, { signal }));
    announce("The drive gains are ready");
  }, signal);
  const wait = async (made) => put(result, found(robot, await awaited("/drive_gains", made, "drive gains", result, signal), onRobot));
  const form = h("form", { onsubmit: send },
    h("p", { class: "note" }, "The same motion without and with a load of known mass gives the torque per unit of current: the drive gains, by total least squares."),
    h("fieldset", {}, h("legend", {}, "Recordings"), uses.element),
    h("div", { class: "fields" }, field("Mass of the known load (kg)", mass, { pointer: "/mass" }), field("Its centre x, y, z (m)", centre, { pointer: "/centre", hint: "In the last joint's frame." })),
    said,
    h("p", {}, submit),
  );
  const element = h("details", { id: "drive-gains" }, h("summary", {}, "Drive gains from a known load"), form, result);
  // What is known already, or is being computed, is shown at once.
  orSay(result, async () => {
    const known = await newestOf("/drive_gains", { robot_id: robot.id }, signal);
    if (!known) return;
    element.open = true;
    await wait(known);
  }, signal);
  return { element, update: uses.update };
}

function found(robot, one, onRobot) {
  const { gains, warnings } = one.result;
  const [first, ...others] = one.tables;
  return [
    warnings.length ? h("div", { class: "box warning" }, h("ul", {}, warnings.map((text) => h("li", {}, text)))) : null,
    shownTable({ ...first, title: `${first.title}, ${moment(one.created_at)}` }, { id: "gains-table", class: "narrow" }),
    others.map((loads) => shownTable(loads, { id: "loads-table", class: "narrow" })),
    gains.every((gain) => gain.unit !== "-") ? takeOver(robot, gains, onRobot) : null,
  ];
}

function takeOver(robot, gains, onRobot) {
  const drives = Object.fromEntries(gains.map((gain) => [gain.joint, { drive_gain: gain.drive_gain }]));
  return robotWith(null, () => withDrives(robot, "with identified drive gains", drives), "Make a robot with these drive gains", onRobot);
}

/** "0, 0, 0.1" as numbers; what is no number is left for the service to complain of. */
function numbersIn(text) {
  return text.split(/[,;\s]+/).filter(Boolean).map((one) => (Number.isNaN(Number(one)) ? one : Number(one)));
}

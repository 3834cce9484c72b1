// Recordings: dropped, described, uploaded, checked.

import { post, upload } from "./api.js";
import { checksInWords, checksTable } from "./checks.js";
import { announce, field, h, put, row, select, table } from "./dom.js";
import { dropZone } from "./drop_zone.js";
import { counted, moment, number, percent, quantity } from "./format.js";
import { clearForm, showInForm } from "./problem.js";
import { drivesIn, gainFields } from "./robot_form.js";

const ROLES = [["identification", "identification"], ["validation", "validation (held out)"], ["friction", "friction"], ["payload", "payload"]];
const UNITS = {
  t: ["s", "ms", "us", "ns"],
  q: ["SI: rad or m", "deg", "mrad", "rev", "mm", "cm"],
  dq: ["SI: rad/s or m/s", "deg/s", "rpm", "mm/s"],
  ddq: ["SI: rad/s² or m/s²", "deg/s^2", "mm/s^2"],
  tau: ["SI: N m or N", "mN m", "kN m", "N mm", "N cm", "mN", "kN"],
  current: ["A", "mA"],
  temperature: ["degC", "K", "degF"],
  base_force: ["N", "mN", "kN"],
  base_moment: ["N m", "mN m", "kN m", "N mm", "N cm"],
};
const NAMES = { t: "time t", q: "positions q", dq: "velocities dq", ddq: "accelerations ddq", tau: "torques tau", current: "currents", temperature: "temperatures", base_force: "forces of the base", base_moment: "moments of the base" };

/** The measurements that a robot has. */
export function measurementsTable(measurements) {
  if (!measurements.length) return h("div", { class: "stored" });
  const rows = measurements.map((one) =>
    row([
      one.name,
      one.role ?? "–",
      `${counted(one.n_samples, "sample")} at ${quantity(one.sampling_rate, "Hz", 4)}`,
      standing(one),
      one.windows.map(([from, to]) => `${from} to ${to} s`).join(", ") || "all",
      h("details", {}, h("summary", {}, checksInWords(one.checks)), checksTable(one.checks)),
      moment(one.created_at),
    ]),
  );
  return h("div", { class: "stored" }, table("Measurements of this robot", ["name", "role", "samples", "each joint stands", "windows", "checks", "uploaded"], rows));
}

/** Share of its time that each joint stands, in the robot's order. */
function standing({ phases }) {
  return phases ? `${phases.standing.map((share) => (100 * share).toFixed(0)).join(", ")} %` : "–";
}

/** Where recordings are dropped; a form appears for each. `forms` are kept when another robot is chosen: what was filled in stays. */
export function measurementForm(robot, { forms, chosen, onStored, onRobot, count }) {
  const add = (files) => {
    for (const file of files) forms.append(fileForm(chosen, file, onStored, count() + forms.childElementCount ? "validation" : "identification"));
    forms.lastChild?.querySelector("input")?.focus();
  };
  return h(
    "div",
    {},
    dropZone("Drop recordings here (CSV or Parquet), or choose them:", { accept: ".csv,.txt,.parquet,.pq", multiple: true, id: "recordings" }, add),
    h("p", { class: "note" }, `Columns: t, q_<joint> or q1, q2, … and tau… or current…; dq…, ddq…, q_command…, temperature…, segment if there are any; base_fx … base_mz, the wrench of the base on the robot. Joints: ${robot.joints.map((one) => one.name).join(", ")}.`),
    forms,
    driveGains(robot, onRobot),
  );
}

/** The form of one file; it belongs to the robot that is `chosen()` when it is sent. */
function fileForm(chosen, file, onStored, role) {
  const name = h("input", { name: "name", required: true, value: file.name.replace(/\.[^.]*$/, ""), maxlength: 200 });
  const mass = h("input", { name: "mass", type: "number", step: "any", min: 0, placeholder: "2.5" });
  const load = field("Mass of the load (kg)", mass, { pointer: "/metadata/payload", hint: "What is known to be carried." });
  const roles = select(ROLES, role, (value) => { load.hidden = value !== "payload"; }, { name: "role" });
  load.hidden = role !== "payload";
  const windows = h("input", { name: "windows", placeholder: "all; or 2 to 10, 15 to 30" });
  const delay = h("input", { name: "delay", type: "number", step: "any", placeholder: "0" });
  const columns = h("textarea", { name: "columns", rows: 3, placeholder: "q1 = shoulder_angle", spellcheck: "false" });
  const units = Object.entries(UNITS).map(([kind, options]) => field(NAMES[kind], select(options.map((unit, index) => [index ? unit : "", unit]), "", null, { "data-unit-of": kind }), { pointer: `/metadata/units/${kind}` }));
  const said = h("div");
  const bar = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Upload" });
  const words = h("span", { class: "note" });
  const submit = h("button", { class: "main" }, "Upload and check");
  const accepted = new Set();

  const metadata = () => ({
    robot_id: chosen().id,
    name: name.value,
    role: roles.value,
    payload: roles.value === "payload" && mass.value ? { mass: Number(mass.value) } : null,
    windows: windowsIn(windows.value),
    units: Object.fromEntries([...form.querySelectorAll("[data-unit-of]")].filter((one) => one.value).map((one) => [one.dataset.unitOf, one.value])),
    columns: columnsIn(columns.value),
    torque_delay: Number(delay.value) / 1000 || 0,
    accept: [...accepted],
  });
  const send = async (event) => {
    event?.preventDefault();
    clearForm(form, said);
    submit.disabled = true;
    bar.hidden = false;
    const progress = (share) => {
      bar.value = share;
      words.textContent = share < 1 ? percent(share, 2) : "checking";
    };
    try {
      const measurement = await upload(file, metadata(), progress);
      announce(`${measurement.name} is stored; checks: ${checksInWords(measurement.checks)}`);
      form.replaceWith(h("details", { open: measurement.checks.some((one) => one.status !== "ok") }, h("summary", {}, `${measurement.name} is stored; checks: ${checksInWords(measurement.checks)}`), checksTable(measurement.checks)));
      onStored(measurement);
    } catch (error) {
      const { checks = [] } = error;
      error.checks = [];
      showInForm(form, said, error);
      if (checks.length) said.append(checksTable(checks, accept));
    }
    submit.disabled = false;
    bar.hidden = true;
    words.textContent = "";
  };
  const accept = (check) => {
    accepted.add(check);
    send();
  };
  const form = h(
    "form",
    { class: "card", onsubmit: send },
    h("p", {}, h("strong", {}, file.name), ` (${number(file.size / 1e6, 2)} MB)`),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/metadata/name" }), field("Role", roles, { pointer: "/metadata/role" }), load, field("Windows (s of t)", windows, { pointer: "/metadata/windows", hint: "The parts to use." })),
    h("details", {}, h("summary", {}, "Units, columns, delay"), h("div", { class: "fields" }, units, field("Delay of the torque (ms)", delay, { pointer: "/metadata/torque_delay" })), field("Columns, where the file's names differ", columns, { pointer: "/metadata/columns", hint: "A line each: ours = the file's", wide: true })),
    said,
    h("p", { class: "actions" }, submit, h("button", { type: "button", onclick: () => form.remove() }, "Leave it out"), bar, words),
  );
  return form;
}

/** "2 to 10, 15-30" as [[2, 10], [15, 30]]; what is no number is left for the service to complain of. */
function windowsIn(text) {
  return text.split(/[,;]/).map((one) => one.trim()).filter(Boolean).map((one) => one.split(/\s*(?:to|…|–|\.\.+|:|(?<=\d)-)\s*/).map((value) => (value === "" || Number.isNaN(Number(value)) ? value : Number(value))));
}

function columnsIn(text) {
  const pairs = text.split("\n").map((line) => line.split("=").map((part) => part.trim())).filter(([ours, theirs]) => ours && theirs);
  return Object.fromEntries(pairs);
}

function driveGains(robot, onRobot) {
  const body = h("div", {}, gainFields(robot.joints.map((one) => ({ ...one, gain: one.drive_gain }))));
  const said = h("div");
  const send = async (event) => {
    event.preventDefault();
    clearForm(form, said);
    try {
      onRobot(await post("/robots", { ...robot.request, name: `${robot.name} with drive gains`.slice(0, 200), drives: { ...robot.request.drives, ...drivesIn(body) } }));
      announce("The robot with these drive gains is chosen");
    } catch (error) {
      showInForm(form, said, error);
    }
  };
  const form = h("form", { onsubmit: send }, body, said, h("p", { class: "actions" }, h("button", {}, "Make a robot with these drive gains"), h("span", { class: "note" }, "Stored recordings keep the gains that they were read with.")));
  return h("details", {}, h("summary", {}, "The recordings have currents: drive gains"), form);
}

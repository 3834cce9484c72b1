// Card of one dropped file: inspected, confirmed, stored; what is typed survives errors.

import { ask, post, upload } from "../api.js";
import { checksInWords, checksTable } from "../recording_checks.js";
import { announce, field, h, put, select } from "../dom.js";
import { number, percent } from "../format.js";
import { givenUp } from "../jobs.js";
import { address } from "../page_address.js";
import { clearForm, problemBox, showInForm } from "../problem.js";
import { choicesOf } from "../schema.js";
import { ColumnsTable } from "./columns_table.js";
import { editInWords, withEdit } from "./revision_edits.js";
import { Guesses } from "./guesses.js";
import { actionOf, robotButton } from "./remedies.js";
import { revise } from "./revise.js";
import { drivesOf, placesOf } from "./robot_facts.js";

/** The form of one file, with the `further` ones of its recording, or of an import that is there already; it belongs to the robot that is `chosen()` when it is sent. */
export function fileCard({ file = null, further = [], found = null, role }, { metadata: known, chosen, onStored, onRobot }) {
  const fields = saidFields((found?.proposed.name ?? file.name).replace(/\.[^.]*$/, ""), known, role);
  const columns = new ColumnsTable();
  const guesses = new Guesses(choicesOf(known.effort_kind));
  const looked = h("div", { hidden: true });
  const robotsFacts = h("div");
  const said = h("div");
  const doing = h("div");
  const accepted = new Set();
  let edits = {};
  let running = null; // what is sent and not yet answered
  const submit = h("button", { class: "main", disabled: true }, "Confirm and store");

  const work = (words) => {
    running?.stop();
    const { signal, bar, how } = (running = givenUp(words, doing));
    return { signal, move: (share) => {
      if (share < 1) bar.value = share;
      else bar.removeAttribute("value");
      put(how, share < 1 ? percent(share, 2) : "inspecting");
    } };
  };

  let looking = null; // what is inspected and not yet known
  const look = () => (looking = inspect());
  const inspect = async () => {
    submit.disabled = true;
    const { signal, move } = work("Uploading");
    const robot = chosen();
    const asked = { robot_id: robot.id, name: fields.name.value || null, columns: columns.byHand, units: guesses.unitsByHand };
    asked.units = Object.fromEntries(Object.entries(asked.units).filter(([, unit]) => unit && unit !== "si"));
    const before = found;
    try {
      found = await upload("/imports", file, asked, { further, onProgress: move, signal });
      if (before) forget(before);
      show(robot);
    } catch (error) {
      if (signal !== running.signal) return;
      submit.disabled = !found;
      const stopped = error.name === "AbortError";
      put(doing, stopped ? h("p", { class: "note" }, "Cancelled; nothing was stored. ", h("button", { type: "button", class: "small", onclick: look }, "Inspect it")) : problemBox(error, look), robotButtons((error.fields ?? []).flatMap((one) => one.remedies ?? []), doing));
    }
  };
  // Where the robot is to be made anew: locked, or mounted otherwise.
  const robotButtons = (remedies, trouble) => {
    const facts = actionOf({ remedies })?.facts;
    return facts ? h("p", { class: "actions" }, robotButton(facts, chosen(), onRobot, (error) => put(trouble, problemBox(error)))) : null;
  };
  const show = (robot) => {
    put(doing);
    const joints = robot.joints.map((one) => one.name);
    columns.fill(found, joints);
    guesses.fill(found, columns.kinds, joints);
    looked.hidden = table.hidden = false;
    submit.disabled = false;
    askOfRobot(robot);
    const { questions } = found;
    put(columnsTitle, columns.inWords);
    table.open = questions.some((one) => one.field.startsWith("columns/"));
    announce(`${nameOfFile()} is inspected: ${questions.length ? `${questions.length} to answer` : "nothing to answer"}`);
  };
  // Where the file lacks what only the robot can tell, its fields stand here.
  const askOfRobot = (robot) => {
    const asks = (field) => found.questions.some((one) => one.field === field);
    const ofServos = found.proposed.effort_kind === "position_command";
    const hasGains = robot.joints.every((one) => one.drive_gain !== null);
    const gains = asks("drives") || (columns.kinds.has("current") && !hasGains);
    const places = asks("columns/q") || asks("columns/tau");
    put(
      robotsFacts,
      robotButtons(found.questions.flatMap((one) => one.remedies ?? []), doing),
      gains ? h("details", { open: true }, h("summary", {}, ofServos ? "The gains of these servos, in N m per rad between command and position" : "The drive gains of these currents"), drivesOf(robot, onRobot)) : null,
      places ? h("details", {}, h("summary", {}, "The file has no columns for some joints: are they locked?"), placesOf(robot, onRobot)) : null,
    );
  };
  const metadata = () => withEdit({
    ...found.proposed,
    robot_id: chosen().id,
    ...fields.values(),
    columns: columns.columns,
    units: guesses.units,
    effort_kind: guesses.effort,
    accept: [...accepted],
  }, edits);
  const send = (event) => {
    event?.preventDefault();
    form.storing = store();
    return form.storing;
  };
  const store = async () => {
    clearForm(form, said);
    submit.disabled = true;
    const { signal, move } = work("Checking and storing");
    const trouble = h("div");
    move(1);
    try {
      stored(await post("/measurements", { import_id: found.id, metadata: metadata() }, { signal }));
    } catch (error) {
      const { checks = [] } = error;
      error.checks = [];
      // The table below says it, with what can be done about it.
      if (checks.some((one) => one.status === "error")) Object.assign(error, { message: "The checks below say what is wrong, and what to do about it.", fields: [] });
      if (error.name === "AbortError") put(said, h("p", { class: "note" }, "Cancelled; nothing was stored. Confirm to try again."));
      else showInForm(form, said, error);
      if (checks.length) said.append(checksTable(checks, accept, { ...inOurHands(trouble), onApply: apply }));
      said.append(trouble);
    }
    submit.disabled = false;
    put(doing);
  };
  const inOurHands = (trouble) => ({
    inWords: inOurWords,
    joints: chosen().joints.map((one) => one.name),
    robot: chosen(),
    onRobot,
    onError: (error) => put(trouble, problemBox(error)),
  });
  const inOurWords = (edit) => editInWords(edit, chosen().joints.map((one) => one.name));
  const accept = (check) => {
    accepted.add(check);
    send();
  };
  const apply = (edit) => {
    edits = withEdit(edits, edit);
    if (edit.windows) fields.windows.value = "";
    put(applied, `Applied: ${inOurWords(edits)}. `, h("button", { type: "button", class: "small", onclick: () => { edits = {}; put(applied); } }, "Undo"));
    send();
  };
  const stored = (measurement) => {
    const words = `${measurement.name} is stored; checks: ${checksInWords(measurement.checks)}`;
    announce(words);
    const trouble = h("div");
    const link = h("a", { href: address({ view: "recording", measurement: measurement.id }) }, "its signals, windows and checks");
    const again = (edit) => revise(measurement, edit, trouble);
    form.replaceWith(h("details", { open: measurement.checks.some((one) => one.status !== "ok") }, h("summary", {}, words), h("p", {}, "Look at ", link, "."), trouble, checksTable(measurement.checks, null, { ...inOurHands(trouble), onApply: again })));
    onStored(measurement);
  };
  const leave = () => {
    running?.stop();
    form.remove();
    if (found) forget(found);
  };
  const nameOfFile = () => (file ? [file, ...further].map((one) => one.name).join(" + ") : found.proposed.name);

  guesses.addEventListener("effort", ({ detail }) => (detail === "motor_current" ? columns.rename("tau", "current") : columns.rename("current", "tau")));
  columns.addEventListener("change", () => {
    put(columnsTitle, columns.inWords);
    guesses.follow(columns.kinds);
    askOfRobot(chosen());
  });
  const applied = h("p", { class: "note" });
  const size = file ? ` (${number([file, ...further].reduce((sum, one) => sum + one.size, 0) / 1e6, 2)} MB)` : " (inspected before)";
  const columnsTitle = h("summary");
  const table = h("details", { hidden: true }, columnsTitle, columns.element, h("p", { class: "note" }, "Change a guess if it is wrong. Two columns cannot be the same signal: if you choose a signal twice, the two columns are exchanged."));
  put(looked, h("h3", {}, "What the file seems to contain"), guesses.element, robotsFacts);
  const form = h("form", { class: "card", onsubmit: send },
    h("p", {}, h("strong", {}, nameOfFile()), size),
    fields.element,
    doing,
    looked,
    applied,
    said,
    h("p", { class: "actions" }, submit, h("button", { type: "button", onclick: leave }, "Leave it out")),
    table,
  );
  form.files = file ? [file, ...further] : [];
  form.leave = leave;
  // For a button that confirms several: whether all that is asked for is answered, and then whether it was stored.
  form.confirm = async () => {
    await looking; // pressed while the file is still being inspected, it is stored as soon as it is
    return !submit.disabled && form.reportValidity() && send();
  };
  // Another robot: its joints and gains are what the file is to be looked at for.
  form.addEventListener("robot", () => (file ? look() : show(chosen())));
  if (found) show(chosen());
  else look();
  return form;
}

/** What nobody is going to use need not be kept for a day. */
function forget(found) {
  ask("DELETE", `/imports/${found.id}`).catch(() => {});
}

/** What people say of a recording beside its columns; `known` are the fields of the contract. */
function saidFields(called, known, role) {
  const name = h("input", { name: "name", required: true, value: called, maxlength: 200 });
  const mass = h("input", { name: "mass", type: "number", step: "any", min: 0, placeholder: "2.5" });
  const load = field("Mass of the load (kg)", mass, { pointer: "/metadata/payload", hint: "The known load that the robot carries." });
  const roles = select(choicesOf(known.role), role, (value) => { load.hidden = value !== "payload"; }, { name: "role" });
  load.hidden = role !== "payload";
  const windows = h("input", { name: "windows", placeholder: "all; or 2 to 10, 15 to 30" });
  const rate = h("input", { name: "rate", type: "number", step: "any", min: 0, placeholder: "by the file's times" });
  const delay = h("input", { name: "delay", type: "number", step: "any", placeholder: "0" });
  const element = h("div", { class: "fields" },
    field("Name", name, { pointer: "/metadata/name" }),
    field("Role", roles, { pointer: "/metadata/role", hint: "Guessed from the file's name (train, fit, excitation; val, test, held); without such a word the longest file is fitted." }),
    load,
    field("Windows (s of t)", windows, { pointer: "/metadata/windows", hint: "The intervals to use; you can drag them after the file is stored." }),
    field("Rows per second", rate, { pointer: "/metadata/rate", hint: "Only for a file without times." }),
    field("Delay of the torque (ms)", delay, { pointer: "/metadata/torque_delay" }),
  );
  const values = () => ({
    name: name.value,
    role: roles.value,
    payload: roles.value === "payload" && mass.value ? { mass: Number(mass.value) } : null,
    windows: windowsIn(windows.value),
    ...(rate.value ? { rate: Number(rate.value) } : {}),
    torque_delay: Number(delay.value) / 1000 || 0,
  });
  return { element, name, windows, values };
}

/** "2 to 10, 15-30" as [[2, 10], [15, 30]]; what is no number is left for the service to complain of. */
function windowsIn(text) {
  return text.split(/[,;]/).map((one) => one.trim()).filter(Boolean).map((one) => one.split(/\s*(?:to|…|–|\.\.+|:|(?<=\d)-)\s*/).map((value) => (value === "" || Number.isNaN(Number(value)) ? value : Number(value))));
}

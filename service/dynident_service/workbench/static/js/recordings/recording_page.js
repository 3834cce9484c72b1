// Page of one recording: raw signals, windows, checks, revisions, models made from it.

import { get } from "../api.js";
import { checksInWords, checksTable } from "../recording_checks.js";
import { whyNoRaw } from "../compare/raw_torque.js";
import { h, put, right, row, section, table } from "../dom.js";
import { counted, moment, percent, quantity } from "../format.js";
import { address } from "../page_address.js";
import { liveSection } from "./live_estimates.js";
import { actionOf } from "./remedies.js";
import { editInWords, stretchesInWords } from "./revision_edits.js";
import { RawStack } from "./raw_stack.js";
import { revise, revisionsOf, takeBack } from "./revise.js";
import { Windows, windowsTable } from "./windows.js";

/** Show a stored recording. */
export async function recordingPage(target, wanted, signal) {
  const measurement = await get(`/measurements/${wanted.measurement}`, {}, signal);
  const [robot, parent, revisions] = await Promise.all([
    get(`/robots/${measurement.robot_id}`, {}, signal),
    measurement.parent_id ? get(`/measurements/${measurement.parent_id}`, {}, signal).catch(() => null) : null,
    revisionsOf(measurement, signal),
  ]);
  signal.throwIfAborted();
  document.title = `${measurement.name}: dynident`;
  if (measurement.under_way) {
    const live = liveSection(measurement, signal, () => recordingPage(target, wanted, signal));
    put(target, header(measurement, robot, parent, revisions), live.element);
    // Whoever leaves the page ends this; what goes wrong stands in the section.
    live.run();
    return;
  }
  const signals = signalsSection(measurement, robot, signal);
  put(target, header(measurement, robot, parent, revisions), signals.element, checksSection(measurement));
  await signals.stack.show();
}

function header(measurement, robot, parent, revisions) {
  const link = (one) => h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name);
  const facts = [
    ["robot", robot.name],
    ["used for", measurement.role ?? "not stated"],
    ["samples", measurement.under_way ? "under way" : `${counted(measurement.n_samples, "sample")} at ${quantity(measurement.sampling_rate, "Hz", 4)}`],
    ["torque", measurement.effort_kind.replaceAll("_", " ")],
    ["windows", measurement.windows.length ? stretchesInWords(measurement.windows) : "all"],
    ["stored", moment(measurement.created_at)],
  ];
  if (revisions.length) facts.push(["revisions", revisions.map((one, index) => [index ? ", " : "", link(one)])]);
  return h("section", { "aria-label": "Recording" },
    h("h1", {}, measurement.name),
    measurement.revision ? revisionBox(measurement, parent, link) : null,
    h("dl", { class: "facts" }, facts.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
    measurement.under_way ? null : h("p", {}, h("a", { href: address({ view: "new", robot: robot.id }) }, "Identify a model with it"), h("span", { class: "note" }, " or upload more recordings of this robot")),
  );
}

function revisionBox(measurement, parent, link) {
  const said = h("div");
  const undo = h("button", { type: "button", id: "undo-revision", onclick: () => takeBack(measurement, said) }, "Undo");
  const last = measurement.edits.at(-1);
  return h("div", { class: "box good" },
    h("p", {}, `Revision ${measurement.revision} of `, parent ? link(parent) : "a recording", `: ${editInWords(last, measurement.joints)}.`),
    measurement.edits.length > 1 ? h("details", {}, h("summary", {}, "All changes since the upload"), h("ol", {}, measurement.edits.map((one) => h("li", {}, editInWords(one, measurement.joints))))) : null,
    parent ? h("p", { class: "actions" }, undo, h("span", { class: "note" }, "deletes this revision; the file and earlier changes stay")) : null,
    said,
  );
}

function signalsSection(measurement, robot, signal) {
  const segments = measurement.segments;
  const whole = { from: Math.min(...segments.map((one) => one.start_time)), to: Math.max(...segments.map((one) => one.end_time)) };
  const windows = new Windows({ windows: measurement.windows, exclude: measurement.request.exclude }, whole);
  const stack = new RawStack(measurement, windows, signal);
  const said = h("div");
  const make = h("button", { type: "button", class: "main", id: "make-revision", onclick: async () => {
    make.disabled = true;
    await revise(measurement, windows.edit, said);
    make.disabled = false;
  } }, "Make a revision with these windows");
  const discard = h("button", { type: "button", onclick: () => windows.reset() }, "Discard");
  const words = h("span", { class: "note" });
  const pending = h("p", { class: "actions", hidden: true }, make, discard, words);
  const tell = () => {
    pending.hidden = !windows.edit;
    put(words, windows.edit ? `Not stored yet: ${editInWords(windows.edit, measurement.joints)}.` : "");
  };
  windows.addEventListener("change", tell, { signal });
  const add = (kind) => () => {
    const { from, to } = stack.view.stretch ?? { from: whole.from + (whole.to - whole.from) / 3, to: whole.to - (whole.to - whole.from) / 3 };
    windows.add(kind, from, to);
  };
  const button = (text, kind) => h("button", { type: "button", class: "small", onclick: add(kind) }, text);
  const element = section("signals", "Signals as recorded",
    whyNoRaw(robot) && h("p", { class: "note" }, whyNoRaw(robot)),
    stack.element,
    h("h3", {}, "Windows"),
    h("p", { class: "note" }, "Blue lines are the ends of the used intervals: drag them. Darkened intervals are not used. The buttons below add the whole interval that is shown."),
    windowsTable(windows, signal),
    h("p", { class: "actions" }, button("Use what is shown", "windows"), button("Leave out what is shown", "exclude")),
    pending,
    said,
  );
  return { stack, element };
}

function checksSection(measurement) {
  const said = h("div");
  const apply = (edit) => revise(measurement, edit, said);
  const inWords = (edit) => editInWords(edit, measurement.joints);
  const cures = measurement.checks.filter((one) => actionOf(one)?.edit);
  const hint = cures.length ? "Apply makes a revision of the recording, which can be undone; the file stays as it is." : "The checks propose no change.";
  return section("checks", "Checks",
    h("p", { class: "note" }, `${checksInWords(measurement.checks)}. ${hint}`),
    said,
    checksTable(measurement.checks, null, { onApply: apply, inWords, joints: measurement.joints }),
    standstill(measurement),
  );
}

function standstill({ phases, joints }) {
  if (!phases) return null;
  const rows = joints.map((joint, index) => row([joint, { class: "n", text: percent(phases.standing[index]) }, { class: "n", text: percent(phases.reversing[index]) }]));
  return table("Shares of time per joint", ["joint", right("standstill"), right("reversal")], rows, { class: "narrow" });
}

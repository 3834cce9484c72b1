// Table of a recording's checks: marks, messages and buttons that accept or cure.

import { h, row, table } from "./dom.js";
import { actionOf, inPageWords, robotButton } from "./recordings/remedies.js";

const MARKS = { ok: "✓ ok", warning: "! warning", error: "✕ error" };
const ORDER = { error: 0, warning: 1, ok: 2 };

/**
 * A table of checks, the worst first. With `onAccept`, errors that the user knows to be right can be accepted; with
 * `onApply`, what cures one is applied: it is told the revision, and `inWords` says what its button does. With `onRobot`,
 * a robot is made that is mounted or locked as a check says.
 */
export function checksTable(checks, onAccept = null, { onApply = null, inWords = null, joints = [], robot = null, onRobot = null, onError = null } = {}) {
  const sorted = [...checks].sort((a, b) => ORDER[a.status] - ORDER[b.status]);
  const makeRow = (one) => {
    const { edit, facts } = (one.status !== "ok" || one.apply ? actionOf(one) : null) ?? {};
    return row([
      one.name.replaceAll("_", " "),
      h("span", { class: `mark ${one.status}` }, MARKS[one.status]),
      [
        inPageWords(one.detail, one.remedies, joints),
        where(one),
        onApply && edit
          ? h("button", { type: "button", class: "small apply", onclick: () => onApply(edit) }, `Apply: ${inWords(edit)}`)
          : null,
        onRobot && facts ? robotButton(facts, robot, onRobot, onError) : null,
        onAccept && one.status === "error"
          ? h("button", { type: "button", class: "small", onclick: () => onAccept(one.name) }, "It is right: use it anyway")
          : null,
      ],
    ]);
  };
  const tableOf = (some, caption) => table(caption, ["check", "result", "found"], some.map(makeRow), { class: "checks" });
  const passed = sorted.filter((one) => one.status === "ok" && !one.apply);
  const others = sorted.filter((one) => !passed.includes(one));
  // What passed is looked at by few, and would hide what comes below it.
  return h("div", {},
    others.length ? tableOf(others, "Checks of the recording") : null,
    passed.length ? h("details", {}, h("summary", {}, `${passed.length} ${passed.length === 1 ? "check" : "checks"} passed`), tableOf(passed, "Checks that passed")) : null,
  );
}

/** How many checks ended how, in words. */
export function checksInWords(checks) {
  const count = (status) => checks.filter((one) => one.status === status).length;
  const parts = [`${count("ok")} ok`];
  if (count("warning")) parts.push(`${count("warning")} with a warning`);
  if (count("error")) parts.push(`${count("error")} with an error`);
  return parts.join(", ");
}

function where({ column, row: line, time }) {
  const parts = [column && `column ${column}`, line && `row ${line}`, typeof time === "number" && `t = ${Number(time.toFixed(4))} s`];
  const text = parts.filter(Boolean).join(", ");
  return text ? h("small", { class: "note" }, ` (${text})`) : null;
}

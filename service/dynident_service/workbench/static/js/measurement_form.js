// Choice of recordings: stored ones, and files that are dropped to be uploaded.

import { ask, get } from "./api.js";
import { checksInWords } from "./recording_checks.js";
import { h, put, row, table } from "./dom.js";
import { dropZone } from "./drop_zone.js";
import { counted, moment, number, percent, quantity } from "./format.js";
import { address } from "./page_address.js";
import { fileCard } from "./recordings/file_card.js";
import { drivesOf, placesOf } from "./recordings/robot_facts.js";

const FORMATS = ".csv,.txt,.tsv,.log,.parquet,.pq,.npy,.npz,.mat,.h5,.hdf5,.bag,.db3,.mcap";

/** The measurements that a robot has. */
export function measurementsTable(measurements) {
  if (!measurements.length) return h("div", { class: "stored" });
  const rows = measurements.map((one) =>
    row([
      h("a", { href: address({ view: "recording", measurement: one.id }) }, one.name),
      one.role ?? "–",
      `${counted(one.n_samples, "sample")} at ${quantity(one.sampling_rate, "Hz", 4)}`,
      standing(one),
      one.windows.map(([from, to]) => `${number(from, 6)} to ${number(to, 6)} s`).join(", ") || "all",
      checksInWords(one.checks),
      moment(one.created_at),
    ]),
  );
  return h("div", { class: "stored" }, table("Recordings of this robot", ["name", "role", "samples", "standstill per joint", "windows", "checks", "uploaded"], rows));
}

// In this order: the test of friction or of a payload is what its name says first.
const ROLES = [
  ["payload", /(^|[^a-z])(payload)(?![a-z])/i],
  ["friction", /(^|[^a-z])(friction)(?![a-z])/i],
  ["identification", /(^|[^a-z])(train|training|fit|fitting|ident|identification|exc|excitation|estimation)(?![a-z])/i],
  ["validation", /(^|[^a-z])(val|valid|validation|test|testing|held|holdout|heldout|eval|evaluation|verification)(?![a-z])/i],
];

/** What a recording is for by a word of its name; undefined where that says nothing. */
function namedRole(name) {
  return ROLES.find(([, words]) => words.test(name))?.[0];
}

/** Share of its time that each joint stands, in the robot's order. */
function standing({ phases }) {
  return phases ? phases.standing.map((share) => percent(share, 2)).join(", ") : "–";
}

/** Where recordings are dropped; a card appears for each, with fields of the `metadata` that the contract has. `forms` are kept when another robot is chosen: what was filled in stays. */
export function measurementForm(robot, { forms, metadata, chosen, onStored, onRobot, count, stored = () => [] }) {
  const hands = { metadata, chosen, onStored, onRobot };
  const isFirst = () => !(count() + forms.childElementCount);
  const role = (name) => namedRole(name) ?? (isFirst() ? "identification" : "validation");
  const add = (files) => {
    const roles = new Map([...files].map((file) => [file, namedRole(file.name) ?? "validation"]));
    // Where no name says what to fit, the longest file tells most of a robot's parameters.
    const candidates = [...files].filter((file) => roles.get(file) === "validation").sort((file, other) => other.size - file.size);
    if (isFirst() && candidates.length && ![...roles.values()].includes("identification")) roles.set(candidates[0], "identification");
    for (const [file, use] of roles) forms.append(fileCard({ file, role: use }, hands));
    forms.lastChild?.querySelector("input")?.focus();
  };
  for (const card of forms.querySelectorAll(":scope > form")) card.dispatchEvent(new Event("robot"));
  const earlier = h("div");
  const all = h("button", { type: "button", class: "main", id: "confirm-all" }, "Confirm all");
  const join = h("button", { type: "button", id: "join-all" }, "All of them are one recording");
  const several = h("div", { hidden: true },
    h("p", { class: "actions" }, all, h("span", { class: "note" }, "stores every file below as it is guessed; a file with an open question stays")),
    h("p", { class: "actions" }, join, h("span", { class: "note" }, "if each file has one signal, such as positions or torques")),
  );
  const cards = () => [...forms.querySelectorAll(":scope > form")];
  join.addEventListener("click", () => {
    const parts = cards().filter((card) => card.files.length);
    if (!parts.length) return;
    const [file, ...further] = parts.flatMap((card) => card.files);
    for (const card of parts) card.leave();
    forms.append(fileCard({ file, further, role: role(file.name) }, hands));
  });
  all.addEventListener("click", async () => {
    all.disabled = true;
    for (const card of cards()) await card.confirm();
    all.disabled = false;
  });
  new MutationObserver(() => { several.hidden = cards().length < 2; }).observe(forms, { childList: true });
  several.hidden = cards().length < 2;
  lookedAtBefore(earlier, robot, stored, (found) => forms.append(fileCard({ found, role: role(found.proposed.name) }, hands)));
  return h("div", {},
    dropZone("Drop recordings here, or choose them:", { accept: FORMATS, multiple: true, id: "recordings" }, add),
    h("p", { class: "note" }, `CSV, Parquet, NumPy, MATLAB, HDF5, ROS bags, MCAP: dynident guesses the columns and their units, and shows them before anything is stored. Joints: ${robot.joints.map((one) => one.name).join(", ")}.`),
    several,
    forms,
    earlier,
    h("details", {}, h("summary", {}, "The recordings have currents: drive gains"), drivesOf(robot, onRobot)),
    h("details", {}, h("summary", {}, "Joints are locked, or the base is not upright"), placesOf(robot, onRobot)),
  );
}

/** Files of the robot that were looked at and never stored: the service keeps them for a day. */
async function lookedAtBefore(target, robot, stored, goOn) {
  const { items } = await get("/imports", { limit: 20 }).catch(() => ({ items: [] }));
  const used = new Set(stored().map((one) => one.sha256));
  const left = items.filter((one) => one.proposed.robot_id === robot.id && !used.has(one.sha256));
  if (!left.length) return;
  const lines = left.map((one) => {
    const line = h("li", { class: "actions" }, h("span", {}, `${one.proposed.name}, ${moment(one.created_at)}`), h("button", { type: "button", class: "small", onclick: () => {
      line.remove();
      goOn(one);
    } }, "Continue"), h("button", { type: "button", class: "small", onclick: () => {
      line.remove();
      ask("DELETE", `/imports/${one.id}`).catch(() => {});
    } }, "Discard"));
    return line;
  });
  put(target, h("details", {}, h("summary", {}, `${counted(left.length, "file")} inspected before, not stored`), h("ul", {}, lines)));
}

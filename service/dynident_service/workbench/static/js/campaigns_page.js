// Page of campaigns: begin one, make its motions, drop their recordings, and see the error fall.

import { get, post } from "./api.js";
import { obstacles } from "./design/obstacles.js";
import { field, figures, h, listed, part, put, select } from "./dom.js";
import { USUAL_DRIVES } from "./first_model.js";
import { moment, number, percent, quantity } from "./format.js";
import { awaited } from "./jobs.js";
import { measurementForm } from "./measurement_form.js";
import { address, go } from "./page_address.js";
import { colour, figure, onColours } from "./plots.js";
import { pressed, problemBox, sending } from "./problem.js";
import { controls, said as saidBy, sorted } from "./request_controls.js";
import { formatLinks } from "./save_file.js";
import { choicesOfQuery, fieldsOf } from "./schema.js";
import { byName, shownTable } from "./tables.js";

const WORDS = { asking: "the next motion is to be designed", designing: "the next motion is being designed", waiting: "the motion is to be made", estimating: "the recording is being taken in", reached: "goal reached", unreachable: "goal out of reach", stopped: "budget spent" };
const BOXES = { reached: "good", unreachable: "warning", stopped: "warning" };
// What most people ask for stands in the open, in this order; the rest of what may be asked is folded.
const OPEN = ["robot_time", "runs", "duration", "sampling_rate"];
// A campaign plans motions of all joints at once: what belongs to other kinds of designs is not asked.
const OF_OTHER_KINDS = ["sets", "speeds", "amplitudes", "joints"];
const LONGEST = { duration: "Period of the longest run; a run may take half or a quarter of it", periods: "Number of periods of the longest run" };
const GOALS = { TorqueGoal: "torque is predicted well", ParametersGoal: "parameters are known well", EffectsGoal: "effects are found or ruled out", PayloadGoal: "a load on the last link is known well" };
const WORST = { torque: "joint", parameters: "parameter", effects: "effect", payload: "quantity" };
// What the virtual robot has where nothing else is said, and the load that is looked for.
const LOADED = [...USUAL_DRIVES, "payload"].map((effect) => ({ effect }));
const inTime = (seconds) => (seconds < 120 ? quantity(seconds, "s", 3) : quantity(seconds / 60, "min", 3));

/** With `campaign` that one, else all campaigns and a form for a new one. */
export async function page(target, wanted, signal) {
  document.title = "Campaigns: dynident";
  if (wanted.campaign) return onePage(target, wanted.campaign, signal);
  const [{ items: robots }, { items: campaigns }] = await Promise.all([get("/robots", { limit: 200 }, signal), get("/campaigns", { limit: 50 }, signal)]);
  if (!robots.length) {
    put(target, h("h1", {}, "Campaigns"), h("div", { class: "box warning" }, "There is no robot yet. ", h("a", { href: address({ view: "new" }) }, "Make one from its description"), " first."));
    return;
  }
  const nameOf = new Map(robots.map((one) => [one.id, one.name]));
  const columns = [
    ["campaign", (one) => h("a", { href: address({ view: "campaigns", campaign: one.id }) }, one.name ?? "campaign")],
    ["robot", (one) => nameOf.get(one.request.robot_id) ?? "–"],
    ["date", (one) => moment(one.created_at)],
    ["state", (one) => WORDS[one.state]],
    figures("robot time", (one) => one.robot_time, inTime),
    figures("error", (one) => one.achieved, (error) => percent(error)),
    figures("goal", (one) => aimOf(one.request.goal), (aim) => percent(aim)),
  ];
  put(target, h("h1", {}, "Campaigns"),
    h("p", {}, "Say how accurate the model has to be. dynident designs one motion after the other, until the goal is reached or cannot be."),
    campaigns.length ? listed("Campaigns", columns, campaigns, { id: "campaigns-table" }) : null,
    await campaignForm(robots, wanted.robot));
}

/** Fields that mean something else here than elsewhere. */
function inWords(fields, words) {
  return Object.fromEntries(Object.entries(fields).map(([id, schema]) => [id, words[id] ? { ...schema, description: words[id] } : schema]));
}

async function campaignForm(robots, chosen) {
  const kinds = Object.keys(GOALS);
  const [budget, trajectory, own, ...goals] = await Promise.all(["Budget", "Trajectory", "CampaignRequest", ...kinds].map(fieldsOf));
  const robot = select(robots.map((one) => [one.id, one.name]), chosen || robots[0].id, () => {}, { id: "campaign-robot" });
  const name = h("input", { maxlength: 200, id: "campaign-name" });
  const prefix = "campaign-";
  const around = await obstacles({}, prefix);
  const groups = {
    budget: controls(budget, { pointer: "/budget", prefix }),
    trajectory: controls(inWords(trajectory, LONGEST), { but: OF_OTHER_KINDS, pointer: "/trajectory", prefix }),
  };
  const rest = controls(own, { but: ["robot_id", "name", "measurement_ids"], prefix });
  const [open, folded] = sorted([...Object.values(groups).flat(), ...rest], OPEN);
  const aims = goals.map((fields) => controls(fields, { but: ["kind", "region_ids"], pointer: "/goal", prefix }));
  const wanted = h("div", { class: "fields" });
  const show = (kind) => put(wanted, aims[kinds.indexOf(kind)].map((one) => one.element));
  const kind = select(Object.entries(GOALS), kinds[0], show, { id: "campaign-goal" });
  show(kinds[0]);
  const said = h("div");
  const submit = h("button", { class: "main", id: "begin-campaign" }, "Begin the campaign");
  const send = sending(submit, said, async () => {
    const parts = Object.fromEntries(Object.entries(groups).map(([key, all]) => [key, saidBy(all)]));
    const index = kinds.indexOf(kind.value);
    const goal = { kind: goals[index].kind.const ?? goals[index].kind.default, ...saidBy(aims[index]) };
    const made = await post("/campaigns", { goal, robot_id: robot.value, name: name.value.trim() || null, ...parts, ...saidBy(rest), ...around.read() });
    go({ view: "campaigns", campaign: made.id });
  });
  return h("form", { id: "campaign-form", onsubmit: send, novalidate: true },
    h("h2", {}, "A new campaign"),
    h("div", { class: "fields" }, field("Robot", robot), field("Go on until", kind)),
    wanted,
    h("div", { class: "fields" }, open.map((one) => one.element), field("Name", name, { pointer: "/name" })),
    around.element,
    h("details", { class: "more" }, h("summary", {}, "More options"), h("div", { class: "fields" }, folded.map((one) => one.element))),
    said, h("p", {}, submit));
}

async function onePage(target, id, signal) {
  const first = await get(`/campaigns/${id}`, {}, signal);
  const [robot, metadata, formats] = await Promise.all([get(`/robots/${first.request.robot_id}`, {}, signal), fieldsOf("MeasurementMetadata"), choicesOfQuery("/v1/designs/{design_id}/trajectory", "format")]);
  const title = first.name ?? "Campaign";
  document.title = `${title}: dynident`;
  const about = { robot, metadata, formats };
  const body = h("div");
  put(target, h("p", {}, h("a", { href: address({ view: "campaigns" }) }, "← All campaigns")), h("h1", {}, title),
    h("p", { class: "note" }, `${robot.name}; ${moment(first.created_at)}; goal: ${goalInWords(first.request.goal)}, in ${inTime(first.request.budget.robot_time)} of robot time`), body);
  const show = async () => put(body, ...shown(await get(`/campaigns/${id}`, {}, signal), about, show, signal));
  put(body, ...shown(first, about, show, signal));
}

/** What a campaign has come to, and what is to be done next; `again` shows it anew. */
function shown(campaign, about, again, signal) {
  const { campaign: runs } = byName(campaign);
  const chart = h("div", { class: "chart", id: "campaign-chart" });
  if (runs) {
    const draw = () => chart.isConnected && courseOf(chart, campaign, signal);
    onColours(draw, signal);
    requestAnimationFrame(draw);
  }
  return [
    h("div", { class: `box ${BOXES[campaign.state] ?? ""}`, id: "campaign-state", "data-state": campaign.state },
      h("p", {}, h("strong", {}, `${WORDS[campaign.state][0].toUpperCase()}${WORDS[campaign.state].slice(1)}. `), campaign.decision.sentence),
      campaign.identification_id ? h("p", {}, h("a", { href: address({ identification: campaign.identification_id }) }, "The model from all runs")) : null),
    nextStep(campaign, about, again, signal),
    runs ? [chart, shownTable(runs, { id: "campaign-runs" })] : null,
  ];
}

function nextStep(campaign, about, again, signal) {
  const said = h("div");
  const fail = (error) => put(said, problemBox(error));
  const last = campaign.steps.at(-1);
  const follow = (path, resource, words) => awaited(path, resource, words, said, signal).then(again, (error) => signal.aborted || fail(error));
  // A page that is opened in the middle of it goes on with what is under way.
  if (campaign.state === "designing") follow("/designs", { ...last, id: last.design_id }, "Designing the motion");
  if (campaign.state === "estimating") follow("/identifications", { ...last, id: last.identification_id }, "Taking in the recording");
  if (campaign.state === "asking") {
    const button = h("button", { type: "button", class: "main", id: "ask", onclick: () => pressed(button, async () => follow("/designs", await post(`/campaigns/${campaign.id}/ask`, {}), "Designing the motion"), fail, signal) }, "Design the next motion");
    return part("Next motion", last?.error ? problemBox(last.error) : null, h("p", { class: "actions" }, button, h("span", { class: "note" }, "the motion that lowers the error most in its time")), said);
  }
  return campaign.state === "waiting" ? motionToMake(campaign, about, follow, said, fail, signal) : said;
}

/** The motion that waits: where to get it, and where its recording goes. */
function motionToMake(campaign, { robot, metadata, formats }, follow, said, fail, signal) {
  const tell = async (measurement) => follow("/identifications", await post(`/campaigns/${campaign.id}/tell`, { measurement_id: measurement }), "Taking in the recording");
  const button = h("button", { type: "button", id: "simulate-run", disabled: !robot.has_inertias, onclick: () => pressed(button, async () => {
    const seed = campaign.steps.flatMap((one) => one.runs).length + 1;
    const { goal } = campaign.request;
    const load = goal.kind === "payload" && seed > goal.unloaded_runs ? { effects: LOADED } : {};
    const made = await post("/simulations", { robot_id: robot.id, design_id: campaign.design_id, name: `virtual run ${seed}`, seed, ...load });
    await tell((await awaited("/simulations", made, "Simulating the motion", said, signal)).result.measurement_id);
  }, fail, signal) }, "Make it with the virtual robot");
  const step = campaign.steps.at(-1);
  const forms = h("div");
  const recordings = measurementForm(robot, { forms, metadata, chosen: () => robot, onStored: (one) => tell(one.id).catch(fail), onRobot: () => {}, count: () => 0 });
  return part("Motion to make",
    h("p", {}, `It takes ${inTime(step.duration)}${step.promised && campaign.promised !== null ? ` and promises an error of ${percent(campaign.promised)} on the worst ${WORST[campaign.request.goal.kind]}` : ""}. `,
      h("a", { href: address({ view: "design", robot: robot.id, design: campaign.design_id }) }, "Look at it")),
    h("p", { class: "actions" }, formatLinks(formats, (format) => `/v1/designs/${campaign.design_id}/trajectory?format=${format}`, said), button),
    said,
    h("h3", {}, "Its recording"),
    recordings);
}

/** The error at which a goal is reached; of effects, the size that would have shown over the usual one. */
function aimOf(goal) {
  return goal.error ?? 1;
}

function goalInWords(goal) {
  if (goal.kind === "parameters") return `${goal.parameters.join(", ")} within ${percent(goal.error)}`;
  if (goal.kind === "effects") return `${goal.effects.join(", ")} found or ruled out`;
  if (goal.kind === "payload") {
    return goal.quantities.map((one) => `${one.replace("_", " ")} within ${one === "mass" ? quantity(goal.mass_error, "kg", 3) : quantity(goal.centre_error, "m", 3)}`).join(", ");
  }
  return `torque within ${percent(goal.error)} up to ${percent(goal.speed)} of the speeds`;
}

/** The error over robot time: promised before each run, reached after it, and the goal. */
function courseOf(target, campaign, signal) {
  const runs = campaign.steps.flatMap((one) => one.runs);
  const [unit, scale] = runs.reduce((sum, one) => sum + one.seconds, 0) < 120 ? ["s", 1] : ["min", 60];
  let seconds = 0;
  // From zero, so that the goal is a line before there are two runs.
  const elapsed = [0, ...runs.map((one) => (seconds += one.seconds) / scale)];
  // An effect that would have shown at no size has none to draw.
  const inPercent = (errors) => (errors && !errors.includes(null) ? 100 * Math.max(...errors) : null);
  const { goal } = campaign.request;
  const line = (label, values, stroke, more = {}) => ({ label, values, stroke, ...more });
  figure(target, {
    title: `Error of the worst ${WORST[goal.kind]} over robot time`,
    height: 230,
    x: { label: `robot time (${unit})`, words: (raw) => `${number(raw, 3)} ${unit}`, values: elapsed, scale: { range: (_, __, high) => [0, 1.08 * (high || 1)] } },
    y: { label: "error (%)", words: (raw) => percent(raw / 100), scale: goal.kind === "effects" ? {} : { distr: 3 } },
    lines: [
      line("reached", [null, ...runs.map((one) => inPercent(one.achieved))], colour("residual"), { width: 2, points: { show: true, size: 8 } }),
      line("promised", [null, ...runs.map((one) => inPercent(one.promised))], colour("predicted"), { width: 0, points: { show: true, size: 9 } }),
      line("goal", elapsed.map(() => 100 * aimOf(goal)), colour("good-line"), { dash: [6, 4] }),
    ],
  }, signal);
}

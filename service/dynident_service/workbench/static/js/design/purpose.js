// The purpose of an experiment in words, and the criterion that follows from it.

import { field, h, put, select } from "../dom.js";

const LATER = new Set(["parameters", "separation"]); // They need names, which the purposes give.

/** Choices of what the experiment is for; `read()` gives the criterion of the request. */
export function purposeChoice(robot, effects, criteria, given) {
  const proposed = given && LATER.has(given.name) ? given : null;
  const usual = given && !proposed ? given.name : "condition_number";
  const criterion = select(criteria.filter((one) => !LATER.has(one.name)).map((one) => [one.name, one.label]), usual, () => tell(), { id: "criterion" });
  const words = h("span", { class: "note" });
  // Two that are easily confused, to begin with.
  const first = effects.items.findLast((one) => one.scope !== "robot" && one.confused_with.length) ?? effects.items[0];
  const pair = [rival(robot, effects, "First effect", first.id), rival(robot, effects, "Second effect", first.confused_with[0] ?? first.id)];
  const last = robot.joints.length;
  const ofLast = robot.base_parameters.names.filter((name) => Number(/(\d+)$/.exec(name)?.[1]) === last);
  const purposes = [
    ["all", "All parameters", "Every base parameter, as accurately as possible.", h("div", { class: "fields" }, field("Measured by", criterion), words), () => ({ name: criterion.value })],
    ["payload", "The payload", `The load changes these parameters of the last link: ${ofLast.join(", ") || "none can be determined"}. Run the motion with and without the load.`, null, () => ({ name: "parameters", parameters: ofLast })],
    ["separate", "Distinguish two effects", "Two effects that look alike in the existing data.", h("div", { class: "fields" }, pair.map((one) => one.element)), () => ({ name: "separation", effects: pair.map((one) => one.read()) })],
  ];
  if (proposed) purposes.unshift(["proposed", "As proposed", inWords(proposed, effects), null, () => proposed]);
  const more = h("div");
  const radios = purposes.map(([id, text, about], index) =>
    h("label", { class: "pick-one" }, h("input", { type: "radio", name: "purpose", value: id, checked: index === 0, onchange: () => choose() }), h("strong", {}, ` ${text} `), h("span", { class: "note" }, about)));
  const chosen = () => purposes.find(([id]) => id === element.querySelector("input[name=purpose]:checked").value);
  const tell = () => { words.textContent = criteria.find((one) => one.name === criterion.value).words; };
  const choose = () => put(more, chosen()[3]);
  const element = h("fieldset", { class: "list-of-choices", "data-pointer": "/criterion" }, h("legend", {}, "Purpose"), radios, more);
  tell();
  choose();
  return { element, read: () => chosen()[4]() };
}

function rival(robot, effects, label, usual) {
  const place = select(robot.joints.map((one) => [one.name, one.name]), robot.joints.at(-1).name, null, { "aria-label": `Joint of the ${label.toLowerCase()}` });
  const onJoints = (id) => effects.byId.get(id).scope !== "robot";
  const control = select(effects.items.map((one) => [one.id, one.title]), usual, (id) => { place.hidden = !onJoints(id); });
  const element = field(label, control);
  element.append(place);
  return { element, read: () => ({ effect: control.value, joints: onJoints(control.value) ? [place.value] : [] }) };
}

function inWords(criterion, effects) {
  if (criterion.name === "parameters") return `For the parameters ${criterion.parameters.join(", ")}.`;
  const names = criterion.effects.map((one) => `${effects.byId.get(one.effect)?.title ?? one.effect}${one.joints.length ? ` on ${one.joints.join(", ")}` : ""}`);
  return `To distinguish ${names.join(" and ")} from ${names.length > 1 ? "each other and " : ""}the rest of the model.`;
}

// Tree of a robot's limbs: choosing one leaves its joints alone in tables and figures.

import { h } from "./dom.js";
import { asked, remember } from "./page_address.js";

// What belongs to one joint says so by `data-joint`; joints of other limbs are hidden by one sheet of rules.
const hiding = new CSSStyleSheet();
document.adoptedStyleSheets.push(hiding);

/** The tree of `robot`, as the service words it; null for a robot that does not branch. `onChoose` is given a limb's joints. */
export function limbTree({ limbs }, onChoose, signal) {
  hiding.replaceSync("");
  if (!limbs.length) return null;
  signal.addEventListener("abort", () => hiding.replaceSync(""));
  const choose = (chosen) => {
    const others = limbs[0].joints.filter((joint) => !limbs[chosen].joints.includes(joint)).map((joint) => `[data-joint="${CSS.escape(joint)}"]`);
    if (others.length) hiding.replaceSync(`:is(${others}), tr:has(> th > :is(${others})) { display: none !important }`);
    else hiding.replaceSync("");
    buttons.forEach((button, k) => button.setAttribute("aria-pressed", String(k === chosen)));
    onChoose(limbs[chosen].joints);
  };
  const press = (k) => () => {
    remember({ limb: k ? String(k) : "" });
    choose(k);
  };
  const buttons = limbs.map(({ title }, k) => h("button", { type: "button", class: "small", onclick: press(k) }, title));
  const below = (parent) => {
    const items = limbs.map((one, k) => one.parent === parent && h("li", {}, buttons[k], below(k)));
    return items.some(Boolean) ? h("ul", {}, items) : null;
  };
  const wanted = Number(asked().limb);
  choose(limbs[wanted] ? wanted : 0);
  return h("nav", { class: "limbs", "aria-label": "Limbs" }, below(null));
}

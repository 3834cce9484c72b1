// Choice of what each measurement is used for (fit, held-out, earlier, later).

import { h, put, select } from "./dom.js";

/**
 * A choice for each measurement among `uses`, [use, words] each. `update(measurements)` shows them and keeps what has been
 * chosen; `chosen(use)` gives the ids of those used so, `lineOf(id)` the element of one. `usual(one)` is the use to begin
 * with, `about(one)` what is said of it, `called` what its control is of.
 */
export function usesOf(uses, { usual, called, about = () => "", ...props }) {
  const lines = new Map();
  const element = h("div", { class: "list-of-choices", ...props });
  const line = (one) => {
    const control = select(uses, usual(one), null, { "aria-label": `${called} of ${one.name ?? one.id}` });
    return { control, element: h("p", { class: "pick-one" }, control, ` ${one.name ?? one.id} `, h("span", { class: "note" }, about(one))) };
  };
  const update = (measurements) => {
    for (const one of measurements) if (!lines.has(one.id)) lines.set(one.id, line(one));
    put(element, measurements.map((one) => lines.get(one.id).element));
  };
  const chosen = (use) => [...lines].filter(([, { control }]) => control.value === use).map(([id]) => id);
  return { element, update, chosen, lineOf: (id) => lines.get(id).element };
}

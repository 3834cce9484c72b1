// Sortable and filterable table; its order stands in the address.

import { field, h, put, unseen } from "../dom.js";
import { counted } from "../format.js";
import { asked, remember } from "../page_address.js";

/**
 * Columns are { id, name, value(item), cell(item), right }: `value` is what is sorted by and searched in.
 * A column with `folded` is shown when it is chosen. `update(items)` shows others; `usual` is how it is sorted without a wish, "-" before a column for the largest first.
 */
export function sortable({ caption, noun, columns: every, usual, empty, id, rowOf = () => ({}) }) {
  const wanted = asked();
  const choosing = columnChoice(every, id, () => { put(headRow, columns().map((one) => heads.get(one.id))); show(); });
  const columns = () => every.filter((one) => choosing.shows(one));
  const state = { items: [], sort: known(every, wanted.sort) ? wanted.sort : usual, filter: wanted.filter };
  const search = h("input", { type: "search", id: `${id}-filter`, value: state.filter, autocomplete: "off", oninput: () => filter() });
  const count = h("span", { class: "note", role: "status" });
  const body = h("tbody");
  const headRow = h("tr");
  const heads = new Map(every.map((one) => [one.id, headOf(one)]));

  function headOf(column) {
    const sort = () => {
      state.sort = state.sort === column.id ? `-${column.id}` : column.id;
      remember({ sort: state.sort });
      show();
    };
    const head = column.value ? h("button", { type: "button", class: "plain", onclick: sort }, column.name) : column.name || unseen("actions");
    return h("th", { scope: "col", class: column.right ? "n" : null, "data-column": column.id }, head);
  }

  function filter() {
    state.filter = search.value;
    remember({ filter: state.filter });
    show();
  }

  function show() {
    const down = state.sort.startsWith("-");
    const chosen = every.find((one) => one.id === state.sort.replace("-", ""));
    for (const [name, head] of heads) {
      if (name === chosen.id) head.setAttribute("aria-sort", down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    }
    const shown = state.items.filter((item) => holds(every, item, state.filter)).sort((a, b) => order(chosen.value(a), chosen.value(b), down));
    const words = state.filter ? `${counted(shown.length, noun)} of ${state.items.length}` : counted(shown.length, noun);
    count.textContent = words;
    put(body, shown.length ? shown.map((item) => rowElement(columns(), item, rowOf(item))) : h("tr", {}, h("td", { colspan: columns().length }, state.items.length ? "No row contains all of these words: shorten the filter." : empty)));
  }

  const element = h("div", { id },
    h("div", { class: "bar-of-fields" }, field("Filter", search), count, choosing.element),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
      h("table", {}, h("caption", { class: "unseen" }, caption), h("thead", {}, headRow), body)),
  );
  put(headRow, columns().map((one) => heads.get(one.id)));
  const update = (items) => {
    state.items = items;
    show();
  };
  return { element, update, show };
}

/** Boxes that say which columns are shown; remembered by this browser. */
function columnChoice(columns, id, onChange) {
  const key = `columns-of-${id}`;
  const chosen = new Map(JSON.parse(localStorage.getItem(key) ?? "[]"));
  const shows = (one) => chosen.get(one.id) ?? !one.folded;
  if (!columns.some((one) => one.folded)) return { shows, element: null };
  const boxes = columns.filter((one) => one.name && one.value && one.id !== "name").map((one) => h("label", { class: "pick-one" }, h("input", { type: "checkbox", "data-shows": one.id, checked: shows(one), onchange: (event) => {
    chosen.set(one.id, event.target.checked);
    localStorage.setItem(key, JSON.stringify([...chosen]));
    onChange();
  } }), ` ${one.name}`));
  return { shows, element: h("details", { class: "columns-choice" }, h("summary", {}, "Columns"), h("div", { class: "choices" }, boxes)) };
}

function known(columns, sort) {
  return columns.some((one) => one.value && one.id === sort.replace("-", ""));
}

function holds(columns, item, filter) {
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  if (!words.length) return true;
  const text = columns.filter((one) => one.value).map((one) => one.text?.(item) ?? one.value(item) ?? "").join(" ").toLowerCase();
  return words.every((word) => text.includes(word));
}

/** What has no value comes last, whichever way is sorted. */
function order(a, b, down) {
  const [none, other] = [a === null || a === undefined || a === "", b === null || b === undefined || b === ""];
  if (none || other) return none - other;
  const up = typeof a === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true });
  return down ? -up : up;
}

function rowElement(columns, item, props) {
  const naming = columns.findIndex((one) => !one.control);
  return h("tr", props, columns.map((one, index) => h(index === naming ? "th" : "td", { class: one.right ? "n" : null, scope: index === naming ? "row" : null }, one.cell(item))));
}

// Helpers that make elements, tables and forms; text is never markup.

const SVG = "http://www.w3.org/2000/svg";

/** Make an element: h("p", { class: "note", onclick: f }, "text", child, [more]). */
export function h(tag, props = {}, ...children) {
  return fill(document.createElement(tag), props, children);
}

/** Make an SVG element. */
export function svg(tag, props = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), props, children);
}

/** Replace what is in an element. */
export function put(element, ...children) {
  element.replaceChildren(...children.flat(Infinity).filter(isShown));
  return element;
}

/** Say something to people who do not see the page. */
export function announce(text) {
  document.getElementById("announcer").textContent = text;
}

let lastId = 0;

/** An id for `for` and `aria-describedby`. */
export function newId(stem) {
  lastId += 1;
  return `${stem}-${lastId}`;
}

/** A labelled form control; its problems are shown beneath it (see problem.js). */
export function field(label, control, { hint = "", pointer = "", wide = false } = {}) {
  control.id ||= newId("field");
  const note = hint ? h("small", { class: "note", id: `${control.id}-hint` }, hint) : null;
  if (note) control.setAttribute("aria-describedby", note.id);
  return h("div", { class: wide ? "field wide" : "field", "data-pointer": pointer || null },
    h("label", { for: control.id }, label),
    control,
    note,
  );
}

/** A select from [value, text] pairs. */
export function select(options, chosen, onchange, props = {}) {
  const made = options.map(([value, text]) => h("option", { value, selected: value === chosen }, text));
  return h("select", { onchange: (event) => onchange?.(event.target.value), ...props }, made);
}

/** A table from header cells and rows; a cell is text, a node, or { text, class }. */
export function table(caption, head, rows, props = {}) {
  const named = head.map((cell) => (cell === "" ? unseen("actions") : cell));
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    h("table", props,
      h("caption", {}, caption),
      h("thead", {}, h("tr", {}, named.map((cell) => cellOf("th", cell, { scope: "col" })))),
      h("tbody", {}, rows),
    ),
  );
}

/** A table with a row for each of `items`; a column is [head, cell(item, index)], and none where it is false. */
export function listed(caption, columns, items, props = {}, rowProps = () => ({})) {
  const shown = columns.filter(Boolean);
  const rows = items.map((one, k) => row(shown.map(([, cell]) => cell(one, k)), rowProps(one, k)));
  return table(caption, shown.map(([head]) => head), rows, props);
}

/** A column of figures: `value(item, index)` in `words`, and exactly for programs. */
export function figures(head, value, words) {
  return [right(head), (one, k) => numeric(words(value(one, k), one), value(one, k))];
}

/** The head of a column of figures. */
export function right(text) {
  return { text, class: "n" };
}

/** A part of a page under its heading. */
export function section(name, title, ...body) {
  return h("section", { "aria-labelledby": `${name}-title` }, h("h2", { id: `${name}-title` }, title), body);
}

/** A button that chooses a joint of a model. */
export function jointButton(model, joint, props = {}) {
  return h("button", { type: "button", "data-joint": joint, "aria-pressed": String(joint === model.joint), onclick: () => model.chooseJoint(joint), ...props }, joint);
}

/** Figures that stand out: [name, value, what more there is to say, id of the value or null] each. */
export function tiles(all) {
  const tile = ([name, value, more, id = null]) => h("div", {}, h("dt", {}, name), h("dd", { class: "value", id }, value), h("dd", { class: "note" }, more));
  return h("dl", { class: "tiles" }, all.map(tile));
}

/** A part of a page that its title names. */
export function part(title, ...body) {
  return h("section", { "aria-label": title }, h("h2", {}, title), body);
}

/** Words for those alone who have the page read to them. */
export function unseen(words) {
  return h("span", { class: "unseen" }, words);
}

/** A row whose first cell names it. */
export function row(cells, props = {}) {
  const [first, ...rest] = cells;
  return h("tr", props, cellOf("th", first, { scope: "row" }), rest.map((cell) => cellOf("td", cell)));
}

/** A number's cell: { value } is its exact value for programs. */
export function numeric(text, value) {
  return { class: "n", text: value === undefined ? text : h("data", { value: value ?? "" }, text) };
}

function cellOf(tag, cell, props = {}) {
  const plain = cell === null || typeof cell !== "object" || cell instanceof Node || Array.isArray(cell);
  if (plain) return h(tag, props, cell);
  const { text, ...more } = cell;
  return h(tag, { ...props, ...more }, text);
}

function fill(element, props, children) {
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") for (const [key, one] of Object.entries(value)) element.style.setProperty(key, one);
    else if (name === "value" && "value" in element) element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(Infinity).filter(isShown));
  return element;
}

function isShown(child) {
  return child !== null && child !== undefined && child !== false && child !== "";
}

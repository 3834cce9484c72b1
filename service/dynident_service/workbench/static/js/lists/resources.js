// A page with one table of resources that have labels.

import { h, put } from "../dom.js";
import { address, remember } from "../location.js";
import { problemBox } from "../problem.js";
import { archivedBox } from "./labels.js";
import { readAll } from "./reading.js";
import { sortable } from "./sortable.js";

/** `columns(changed)` gives the table's columns; `changed(before)(after)` puts one in its place that was relabelled. */
export async function resourcesPage(target, { title, path, noun, columns, id, empty }, wanted, signal) {
  const state = { archived: wanted.archived === "yes", items: [] };
  const said = h("div");
  const changed = (before) => (after) => {
    state.items = state.items.map((one) => (one.id === before.id ? after : one)).filter((one) => one && (state.archived || !one.archived));
    list.update(state.items);
  };
  const list = sortable({ caption: title, noun, columns: columns(changed), usual: "-date", id, empty, rowOf: (one) => ({ "data-id": one.id }) });
  const read = async () => {
    try {
      await readAll(path, { archived: state.archived || null }, (items) => {
        state.items = [...items];
        list.update(state.items);
      }, signal);
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error, read));
    }
  };
  const withArchived = (all) => {
    state.archived = all;
    remember({ archived: all ? "yes" : "" });
    read();
  };
  put(target, h("h1", {}, title), h("p", { class: "actions" }, h("a", { class: "button", href: address({ view: "new" }) }, "New model"), archivedBox(state.archived, withArchived)), said, list.element);
  await read();
}

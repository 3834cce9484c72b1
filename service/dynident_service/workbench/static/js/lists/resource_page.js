// A list page of resources: table, labels, archive; used by the pages of lists.

import { h, put } from "../dom.js";
import { onJobs } from "../jobs.js";
import { address, remember } from "../page_address.js";
import { orSay, problemBox } from "../problem.js";
import { archivedBox } from "./labels.js";
import { readAll } from "./paged_lists.js";
import { sortable } from "./sortable_table.js";

/**
 * `columns(changed, table)` gives the table's columns; `changed(before)(after)` puts one in its place that was relabelled, then
 * `onChanged(before)` is called; `query` is asked with the list; `table.show()` draws the table again, `table.fail(error)` tells an error above it. `acts`
 * stand above the table, which is read again when a job of the kinds `madeBy` succeeded.
 */
export async function resourcesPage(target, { title, caption = title, path, query = {}, noun, columns, id, empty, acts = [], onChanged = () => {}, madeBy = new Set() }, wanted, signal) {
  const state = { archived: wanted.archived === "yes", items: [] };
  const said = h("div");
  const changed = (before) => (after) => {
    state.items = state.items.map((one) => (one.id === before.id ? after : one)).filter((one) => one && (state.archived || !one.archived));
    onChanged(before);
    list.update(state.items);
  };
  const table = { show: () => list.show(), fail: (error) => put(said, problemBox(error)) };
  const list = sortable({ caption, noun, columns: columns(changed, table), usual: "-date", id, empty, rowOf: (one) => ({ "data-id": one.id }) });
  const show = (items) => {
    state.items = [...items];
    list.update(state.items);
  };
  const read = () => orSay(said, () => readAll(path, { ...query, archived: state.archived || null }, show, signal), signal, read);
  const withArchived = (all) => {
    state.archived = all;
    remember({ archived: all ? "yes" : "" });
    read();
  };
  onJobs((job) => madeBy.has(job.kind) && job.state === "succeeded" && read(), signal);
  put(target, h("h1", {}, title), h("p", { class: "actions" }, ...acts, h("a", { class: "button", href: address({ view: "new" }) }, "New model"), archivedBox(state.archived, withArchived)), said, list.element);
  await read();
}

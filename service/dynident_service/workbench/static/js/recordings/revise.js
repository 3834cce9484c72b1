// Send a revision of a recording, wait for it, or take it back.

import { ask, get, post } from "../api.js";
import { announce, h, put } from "../dom.js";
import { givenUp } from "../jobs.js";
import { go } from "../page_address.js";
import { problemBox } from "../problem.js";
import { withEdit } from "./revision_edits.js";

/** Ask for a revision and go to it; how it stands is shown in `target`, and what was chosen stays if it fails. */
export async function revise(measurement, edit, target) {
  const { signal } = givenUp("Checking the file again", target);
  try {
    // A revision states all steps that are left out.
    const stated = edit.skip ? { ...edit, skip: withEdit({ skip: measurement.request.skip }, edit).skip } : edit;
    const made = await post(`/measurements/${measurement.id}/revisions`, stated, { signal });
    announce(`${made.name} is stored`);
    go({ view: "recording", measurement: made.id });
  } catch (error) {
    if (error.name === "AbortError") put(target, h("p", { class: "note" }, "Cancelled; nothing was stored."));
    else put(target, problemBox(error, () => revise(measurement, edit, target)));
  }
}

/** Take a revision back: it is deleted, and its parent is shown. One that others rest on stays, and is said to. */
export async function takeBack(measurement, target) {
  try {
    await ask("DELETE", `/measurements/${measurement.id}`);
    announce(`${measurement.name} is deleted`);
    go({ view: "recording", measurement: measurement.parent_id });
  } catch (error) {
    const open = h("button", { type: "button", onclick: () => go({ view: "recording", measurement: measurement.parent_id }) }, "Show the version before it");
    put(target, problemBox(error), h("p", { class: "actions" }, open));
  }
}

/** The revisions that were made from a measurement, newest first. */
export async function revisionsOf(measurement, signal) {
  const { items } = await get("/measurements", { robot_id: measurement.robot_id, limit: 200 }, signal);
  return items.filter((one) => one.parent_id === measurement.id);
}

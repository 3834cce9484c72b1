// Reads whole lists from the API page by page (50 items), and names of robots.

import { get } from "../api.js";

const PART = 50;
const LATER = 200;

/** Read a list to its end; `onPart(items)` is given all that has come so far. */
export async function readAll(path, query, onPart, signal) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(path, { ...query, limit: items.length ? LATER : PART, cursor }, signal);
    items.push(...page.items);
    cursor = page.cursor;
    onPart(items);
  } while (cursor);
  return items;
}

/** Names of all robots by their ids, archived ones, too. */
export async function robotNames(signal) {
  const items = await readAll("/robots", { archived: true }, () => {}, signal);
  return new Map(items.map((one) => [one.id, one.name]));
}

// Place to drop files on, which is a file button as well.

import { h, newId } from "./dom.js";

/** `onFiles` is given the files that were dropped or chosen; of `folders` all that is below and accepted, if any, each with its `pathInFolder`. */
export function dropZone(text, { accept, multiple = false, folders = false, id = newId("files") }, onFiles) {
  const input = h("input", { type: "file", id, accept, multiple, onchange: () => take(input.files) });
  const zone = h("div", { class: "drop" }, h("label", { for: id }, text), input);
  const take = (files) => {
    if (files.length) onFiles([...files]);
  };
  const over = (event) => {
    event.preventDefault();
    zone.classList.add("over");
  };
  zone.addEventListener("dragenter", over);
  zone.addEventListener("dragover", over);
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    if (folders) below(event.dataTransfer, accept.split(",")).then(onFiles);
    else take(event.dataTransfer.files);
  });
  return zone;
}

/** All files that were dropped, in folders or not, whose names end in one of `endings`. */
async function below(dropped, endings) {
  const found = [];
  const walk = async (entry) => {
    if (entry.isFile) {
      if (!endings.some((one) => entry.name.toLowerCase().endsWith(one))) return;
      const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
      found.push(Object.assign(file, { pathInFolder: entry.fullPath.replace(/^\//, "") }));
      return;
    }
    const reader = entry.createReader();
    // A reader gives a part of a folder at a time, and none at its end.
    for (;;) {
      const entries = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (!entries.length) return;
      for (const one of entries) await walk(one);
    }
  };
  // The list of items is empty as soon as this waits for something.
  const entries = [...dropped.items].map((one) => one.webkitGetAsEntry()).filter(Boolean);
  for (const one of entries) await walk(one);
  return found;
}

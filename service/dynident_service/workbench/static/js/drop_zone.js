// A place to drop files on, which is also a button that opens the file dialog.

import { h, newId } from "./dom.js";

/** `onFiles` is given the files that were dropped or chosen. */
export function dropZone(text, { accept, multiple = false, id = newId("files") }, onFiles) {
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
    take(event.dataTransfer.files);
  });
  return zone;
}

// The model as a file for other programs: what the format cannot hold, or why it cannot hold the model and what to do.

import { file } from "./api.js";
import { announce, h, put } from "./dom.js";
import { problemBox } from "./problem.js";
import { formatLinks, save } from "./saving.js";

const IMPOSSIBLE = "Not physically feasible";

/** A link for each of the `formats`; what there is to say is put into `said`. */
export function exportLinks(model, formats, said) {
  return formatLinks(formats, (format) => `/v1/identifications/${model.id}/export?format=${format}`, (path) => take(path, said));
}

async function take(path, said) {
  try {
    const { content, name, notes } = await file(path);
    save(content, name);
    put(said, notes.length ? noteBox(name, notes) : null);
    announce(`${name} is saved`);
  } catch (error) {
    put(said, problemBox(error), error.title === IMPOSSIBLE ? nearest(path, said) : null);
  }
}

function noteBox(name, notes) {
  return h("div", { class: "box warning", id: "export-notes" },
    h("p", {}, h("strong", {}, `What to know of ${name}`)), h("ul", {}, notes.map((one) => h("li", {}, one))));
}

function nearest(path, said) {
  return h("button", { type: "button", id: "export-nearest", onclick: () => take(`${path}&nearest=true`, said) },
    "Take the nearest feasible parameters");
}

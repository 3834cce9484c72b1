// The model as a file for other programs: what the format cannot hold, or why it cannot hold the model and what to do.

import { file } from "./api.js";
import { announce, h, put } from "./dom.js";
import { problemBox } from "./problem.js";

const IMPOSSIBLE = "Not physically feasible";

/** A link for each of the `formats`; what there is to say is put into `said`. */
export function exportLinks(model, formats, said) {
  return formats.map(([format, text]) => {
    const path = `/v1/identifications/${model.id}/export?format=${format}`;
    // The address stands in the link for copying; a click says more than a download would.
    const onclick = (event) => {
      event.preventDefault();
      take(path, said);
    };
    return h("a", { class: "button", href: path, onclick }, text);
  });
}

async function take(path, said) {
  try {
    const { content, name, notes } = await file(path);
    const link = h("a", { href: URL.createObjectURL(content), download: name });
    link.click();
    URL.revokeObjectURL(link.href);
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

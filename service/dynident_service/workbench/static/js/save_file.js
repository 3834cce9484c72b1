// Download links of files in several formats, with notes on what a format cannot hold; exports of models.

import { file } from "./api.js";
import { announce, h, put } from "./dom.js";
import { problemBox } from "./problem.js";

const IMPOSSIBLE = "Not physically feasible";

/**
 * A link for each of the `formats`, whose file is at `pathOf(format)`; what its format could not hold, or why there is
 * none, is put into `said`, with what `wayOut(error, path)` offers then.
 */
export function formatLinks(formats, pathOf, said, wayOut = () => null) {
  return formats.map(([format, text]) => {
    const path = pathOf(format);
    // The address stands in the link for copying; a click says more than a download would.
    const onclick = (event) => {
      event.preventDefault();
      take(path, said, wayOut);
    };
    return h("a", { class: "button", href: path, "data-format": format, onclick }, text);
  });
}

/** Save the file that is at a path. */
async function take(path, said, wayOut = () => null) {
  try {
    const { content, name, notes } = await file(path);
    save(content, name);
    put(said, notes.length ? noteBox(name, notes) : null);
    announce(`${name} is saved`);
  } catch (error) {
    put(said, problemBox(error), wayOut(error, path));
  }
}

function noteBox(name, notes) {
  return h("div", { class: "box warning", id: "export-notes" },
    h("p", {}, h("strong", {}, `Notes on ${name}`)), h("ul", {}, notes.map((one) => h("li", {}, one))));
}

/** Have the browser save a file. */
export function save(content, name) {
  const link = h("a", { href: URL.createObjectURL(content), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

/** A link for each of the `formats`; what there is to say is put into `said`. */
export function exportLinks(model, formats, said) {
  const nearest = (error, path) =>
    error.title === IMPOSSIBLE && h("button", { type: "button", id: "export-nearest", onclick: () => take(`${path}&nearest=true`, said) }, "Take the nearest feasible parameters");
  return formatLinks(formats, (format) => `/v1/identifications/${model.id}/export?format=${format}`, said, nearest);
}

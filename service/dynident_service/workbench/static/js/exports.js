// Export buttons of a model: formats, notes, and the nearest model that a format can hold.

import { h } from "./dom.js";
import { formatLinks, take } from "./save_file.js";

const IMPOSSIBLE = "Not physically feasible";

/** A link for each of the `formats`; what there is to say is put into `said`. */
export function exportLinks(model, formats, said) {
  const nearest = (error, path) =>
    error.title === IMPOSSIBLE && h("button", { type: "button", id: "export-nearest", onclick: () => take(`${path}&nearest=true`, said) }, "Take the nearest feasible parameters");
  return formatLinks(formats, (format) => `/v1/identifications/${model.id}/export?format=${format}`, said, nearest);
}

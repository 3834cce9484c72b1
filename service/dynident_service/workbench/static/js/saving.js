// Files to be taken along.

import { h } from "./dom.js";

/** A link for each of the `formats`, whose file is at `pathOf(format)`. */
export function formatLinks(formats, pathOf, take) {
  return formats.map(([format, text]) => {
    const path = pathOf(format);
    // The address stands in the link for copying; a click says more than a download would.
    const onclick = (event) => {
      event.preventDefault();
      take(path);
    };
    return h("a", { class: "button", href: path, "data-format": format, onclick }, text);
  });
}

/** Have the browser save a file. */
export function save(content, name) {
  const link = h("a", { href: URL.createObjectURL(content), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

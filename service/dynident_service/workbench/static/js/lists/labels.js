// Edit labels of a resource: rename, tag, archive, delete.

import { patch, remove } from "../api.js";
import { announce, field, h, put } from "../dom.js";
import { counted } from "../format.js";
import { problemBox, showInForm } from "../problem.js";

const PATHS = { comparison: "comparisons", diagnosis: "diagnoses", validation: "validations", report: "reports" };
/** What the page makes unasked goes with what it is of; what somebody asked for goes after a question. */
const [MADE_BY_THE_PAGE, MADE_OF_IT] = [new Set(["comparison"]), new Set(Object.keys(PATHS))];

/** The dialog that changes a resource at `path`; `done(resource)` is given it as it is now, null once it is deleted. */
function openLabels(path, resource, done) {
  const name = h("input", { name: "name", value: resource.name ?? "", maxlength: 200 });
  const tags = h("input", { name: "tags", value: resource.tags.join(", "), autocomplete: "off" });
  const said = h("div");
  const close = () => dialog.close();
  const change = async (body, words) => {
    try {
      const changed = await patch(path, body);
      close();
      announce(words);
      done(changed);
    } catch (error) {
      showInForm(form, said, error);
    }
  };
  const save = (event) => {
    event.preventDefault();
    const wanted = tags.value.split(",").map((one) => one.trim()).filter(Boolean);
    change({ name: name.value.trim() || null, tags: wanted }, "The labels are changed");
  };
  const archive = () => change({ archived: !resource.archived }, resource.archived ? "Back in the lists" : "Archived");
  const erase = async (event) => {
    // Once more, because nothing brings it back.
    if (!event.target.dataset.sure) {
      event.target.dataset.sure = "yes";
      event.target.textContent = "Delete for good?";
      return;
    }
    await eraseWith(MADE_BY_THE_PAGE);
  };
  const eraseWith = async (kinds) => {
    try {
      await removeWith(path, kinds);
      close();
      announce("Deleted");
      done(null);
    } catch (error) {
      put(said, problemBox(error), error.status === 409 ? wayOut(error, () => eraseWith(MADE_OF_IT)) : null);
    }
  };
  const form = h("form", { onsubmit: save },
    h("h2", {}, "Name and tags"),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" }), field("Tags", tags, { pointer: "/tags", hint: "Separated by commas" })),
    said,
    h("p", { class: "actions" }, h("button", { class: "main" }, "Save"), h("button", { type: "button", onclick: close }, "Close without saving")),
    h("p", { class: "actions" }, h("button", { type: "button", onclick: archive }, resource.archived ? "Bring back from the archive" : "Archive"), h("button", { type: "button", onclick: erase }, "Delete")),
    h("p", { class: "note" }, "Archived resources are not in the lists; everything that uses them works as before."),
  );
  const dialog = h("dialog", { class: "labels", "aria-label": "Name and tags" }, form);
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

/** Delete a resource, and before it what rests on it, if all of that is of these kinds. */
async function removeWith(path, kinds) {
  for (;;) {
    try {
      return await remove(path);
    } catch (error) {
      const { dependents } = error;
      if (error.status !== 409 || !dependents.length || !dependents.every((one) => kinds.has(one.kind))) throw error;
      for (const one of dependents) await removeWith(`/${PATHS[one.kind]}/${one.id}`, kinds);
    }
  }
}

function wayOut({ dependents }, eraseAll) {
  const advice = h("p", {}, "Delete those first, or archive this one: then it leaves the lists, and everything that uses it stays.");
  if (!dependents.length || !dependents.every((one) => MADE_OF_IT.has(one.kind))) return advice;
  const kinds = [...new Set(dependents.map((one) => one.kind))].sort();
  const words = kinds.map((kind) => counted(dependents.filter((one) => one.kind === kind).length, kind, PATHS[kind])).join(", ");
  return [advice, h("p", {}, h("button", { type: "button", onclick: eraseAll }, `Delete it with ${words}`))];
}

/** A button that opens the dialog. */
export function labelsButton(path, resource, done) {
  return h("button", { type: "button", class: "small", "aria-label": `Change ${resource.name ?? resource.id}`, onclick: () => openLabels(path, resource, done) }, "Change");
}

/** Tags as chips. */
export function tagChips({ tags, archived }) {
  return [tags.map((one) => h("span", { class: "chip" }, one)), archived ? h("span", { class: "chip" }, "archived") : null];
}

/** Whether what is archived is shown, too: a box that says so in the address. */
export function archivedBox(checked, onchange) {
  return h("label", {}, h("input", { type: "checkbox", checked, onchange: (event) => onchange(event.target.checked) }), " Show archived ones");
}

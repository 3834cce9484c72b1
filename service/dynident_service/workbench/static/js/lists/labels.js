// What a resource is called and filed under: rename, tag, archive, delete.

import { patch, remove } from "../api.js";
import { announce, field, h, put } from "../dom.js";
import { problemBox, showInForm } from "../problem.js";

/** The dialog that changes a resource at `path`; `done(resource)` is given it as it is now, null once it is deleted. */
export function openLabels(path, resource, done) {
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
    try {
      await remove(path);
      close();
      announce("Deleted");
      done(null);
    } catch (error) {
      put(said, problemBox(error), error.status === 409 ? h("p", {}, "Delete those first, or archive this one: archived, it leaves the lists and everything that rests on it stays.") : null);
    }
  };
  const form = h(
    "form",
    { onsubmit: save },
    h("h2", {}, "Name and tags"),
    h("div", { class: "fields" }, field("Name", name, { pointer: "/name" }), field("Tags", tags, { pointer: "/tags", hint: "Separated by commas" })),
    said,
    h("p", { class: "actions" }, h("button", { class: "main" }, "Save"), h("button", { type: "button", onclick: close }, "Leave as it is")),
    h("p", { class: "actions" }, h("button", { type: "button", onclick: archive }, resource.archived ? "Bring back from the archive" : "Archive"), h("button", { type: "button", onclick: erase }, "Delete")),
    h("p", { class: "note" }, "What is archived leaves the lists; everything that rests on it works as before."),
  );
  const dialog = h("dialog", { class: "labels", "aria-label": "Name and tags" }, form);
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
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
  return h("label", {}, h("input", { type: "checkbox", checked, onchange: (event) => onchange(event.target.checked) }), " Show what is archived");
}

// Boxes and form messages of problems (errors of the API), and buttons that report them.

import { h, put } from "./dom.js";
import { checksTable } from "./recording_checks.js";
import { inPageWords } from "./recordings/remedies.js";

/** A box that says what is wrong; with `again`, a button that tries once more. */
export function problemBox(error, again = null) {
  const details = (error.fields ?? []).filter((field) => field.detail !== error.message);
  return h("div", { class: "box error", role: "alert" },
    h("p", {}, h("strong", {}, `${error.title ?? "The page failed"}. `), inPageWords(error.message, (error.fields ?? []).flatMap((field) => field.remedies ?? []))),
    details.length ? h("ul", {}, details.map((one) => h("li", {}, place(one), inPageWords(one.detail, one.remedies)))) : null,
    error.dependents?.length ? h("p", {}, `Used by: ${error.dependents.map((one) => one.id).join(", ")}`) : null,
    error.checks?.length ? checksTable(error.checks) : null,
    again ? h("button", { type: "button", onclick: again }, "Try again") : null,
  );
}

/** Show a problem in a form: each field's own beside it, the rest in `target`. */
export function showInForm(form, target, error) {
  clearForm(form, target);
  const left = [];
  for (const one of error.fields ?? []) {
    const beside = nearest(form, one.pointer);
    if (!beside) {
      left.push(one);
      continue;
    }
    beside.classList.add("wrong");
    for (let folded = beside.closest("details"); folded; folded = folded.parentElement.closest("details")) folded.open = true;
    beside.append(h("p", { class: "complaint", role: "alert" }, inPageWords(one.detail, one.remedies)));
    beside.querySelector("input, select, textarea")?.setAttribute("aria-invalid", "true");
  }
  const all = (error.fields ?? []).length > 0 && left.length === 0;
  put(target, problemBox(all ? { ...summary(error), checks: error.checks } : error));
  const first = form.querySelector("[aria-invalid]");
  if (first) first.focus();
  else target.scrollIntoView({ block: "nearest" });
}

/** Take away what an earlier try complained of. */
export function clearForm(form, target) {
  for (const one of form.querySelectorAll(".complaint")) one.remove();
  for (const one of form.querySelectorAll(".wrong")) one.classList.remove("wrong");
  for (const one of form.querySelectorAll("[aria-invalid]")) one.removeAttribute("aria-invalid");
  put(target);
}

/** What a form does when it is sent, while its button cannot be pressed: what is wrong is said beside its fields, the rest in `said`. */
export function sending(button, said, work, signal = null) {
  return async (event) => {
    event.preventDefault();
    const form = event.currentTarget;
    clearForm(form, said);
    await pressed(button, () => work(form), (error) => showInForm(form, said, error), signal);
  };
}

/** What is to be done before something can be asked. */
export function complaint(text) {
  return h("p", { class: "complaint", role: "alert" }, text);
}

/** Do what a button is for, which cannot be pressed meanwhile; `fail` is told what went wrong, unless nobody waits any more. */
export async function pressed(button, work, fail, signal = null) {
  button.disabled = true;
  try {
    await work();
  } catch (error) {
    if (!signal?.aborted) fail(error);
  }
  button.disabled = false;
}

/** Do something; what goes wrong is said in `place`, unless nobody waits any more. Gives what was done. */
export async function orSay(place, work, signal = null, again = null) {
  try {
    return await work();
  } catch (error) {
    if (!signal?.aborted) put(place, problemBox(error, again));
    return undefined;
  }
}

function summary(error) {
  return { title: error.title, message: error.message };
}

function nearest(form, pointer) {
  let best = null;
  for (const one of form.querySelectorAll("[data-pointer]")) {
    const mine = one.dataset.pointer;
    const fits = pointer === mine || pointer.startsWith(`${mine}/`);
    if (fits && mine.length > (best?.dataset.pointer.length ?? 0)) best = one;
  }
  return best;
}

function place({ pointer, row, time }) {
  const parts = [pointer, row ? `row ${row}` : "", time === null || time === undefined ? "" : `t = ${time} s`];
  const text = parts.filter(Boolean).join(", ");
  return text ? [h("code", {}, text), ": "] : null;
}

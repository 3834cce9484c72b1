// List of identified models with errors, newest first, running ones live.

import { get } from "./api.js";
import { catalogue, titleOf } from "./catalogue.js";
import { h, put } from "./dom.js";
import { judged } from "./joint_errors.js";
import { moment, percent } from "./format.js";
import { MODEL_JOBS, onJobs } from "./jobs.js";
import { address } from "./page_address.js";
import { problemBox } from "./problem.js";

const PART = 30;

export class ModelList {
  constructor(target) {
    this.items = h("ul", { class: "models" });
    this.foot = h("div");
    this.marked = "";
    this.shown = PART;
    this.robots = new Map();
    // Where there is room for one column alone, the list is folded: what was come for stands at the top.
    const wide = matchMedia("(min-width: 1021px)");
    const fold = h("details", { open: wide.matches }, h("summary", {}, h("h2", {}, "Identified models")), this.items, this.foot);
    wide.addEventListener("change", () => { fold.open = wide.matches; });
    put(target, fold);
    onJobs((job) => MODEL_JOBS.has(job.kind) && this.refresh());
  }

  /** Mark the model that is shown. */
  mark(identifier) {
    this.marked = identifier;
    for (const link of this.items.querySelectorAll("a")) this.#markLink(link);
  }

  /** Read the list anew; once more where something has changed while it was read. */
  async refresh() {
    this.changed = true;
    this.again ??= this.#readUntilItIsNew().finally(() => {
      this.again = null;
    });
    await this.again;
  }

  async #readUntilItIsNew() {
    while (this.changed) {
      this.changed = false;
      await this.#read();
    }
  }

  async #read() {
    try {
      const [page, effects] = await Promise.all([get("/identifications", { limit: this.shown, brief: true }), catalogue()]);
      await this.#nameRobots(page.items);
      put(this.items, page.items.map((one) => this.#item(one, effects)));
      put(this.foot, page.items.length ? null : h("p", { class: "note" }, "None yet."), page.cursor ? this.#more() : null);
    } catch (error) {
      put(this.foot, problemBox(error, () => this.refresh()));
    }
  }

  async #nameRobots(models) {
    const unknown = [...new Set(models.map((one) => one.robot_id))].filter((id) => !this.robots.has(id));
    const found = await Promise.all(unknown.map((id) => get(`/robots/${id}`)));
    for (const robot of found) this.robots.set(robot.id, robot.name);
  }

  #item(model, effects) {
    const result = model.result;
    const robot = this.robots.get(model.robot_id);
    const added = [...new Set(model.added.map((one) => `${titleOf(effects, one.effect)}${one.joints.length ? ` on ${one.joints.join(", ")}` : ""}`))].join(", ");
    const link = h("a", { href: address({ identification: model.id }), "data-id": model.id },
      h("strong", {}, model.name || robot),
      added ? h("span", {}, `+ ${added}`) : null,
      h("span", { class: "note" }, [model.name ? `${robot}, ` : "", moment(model.created_at)]),
      result ? errorsOf(result) : h("span", { class: `mark ${model.status}` }, stateInWords(model)),
    );
    this.#markLink(link);
    return h("li", {}, link);
  }

  #markLink(link) {
    if (link.dataset.id === this.marked) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }

  #more() {
    const more = () => {
      this.shown += PART;
      this.refresh();
    };
    return h("button", { type: "button", onclick: more }, "Show older ones");
  }
}

function errorsOf({ residual, validation }) {
  const heldOut = validation ? [h("b", {}, percent(judged(validation).relative_total)), " held out, "] : null;
  return h("span", {}, heldOut, percent(judged(residual).relative_total), " fit");
}

function stateInWords(model) {
  if (model.status === "running") return "running …";
  return model.status === "failed" ? `failed: ${model.error?.title ?? ""}` : model.status;
}

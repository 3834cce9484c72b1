// Page of changes: choose a model, compare two sets of measurements, or follow many days.

import { changesForm, changesTable } from "./changes.js";
import { get, post } from "./api.js";
import { choiceInWords } from "./catalogue.js";
import { daysSection } from "./changes_over_days.js";
import { announce, field, h, put, section, select } from "./dom.js";
import { moment } from "./format.js";
import { awaited, newestOf } from "./jobs.js";
import { address, go } from "./page_address.js";
import { Model } from "./shown_model.js";
import { problemBox } from "./problem.js";

/** Show the form and what came of it, for the model of the address or the newest one. */
export async function page(target, wanted, signal) {
  document.title = "Changes: dynident";
  const { items } = await get("/identifications", { limit: 200, brief: true }, signal);
  const models = items.filter((one) => one.status === "succeeded");
  if (!models.length) {
    put(target, h("h1", {}, "Changes"), h("p", {}, "A change is found with a model of the robot: ", h("a", { href: address({ view: "new" }) }, "identify one"), " first."));
    return;
  }
  const chosen = models.find((one) => one.id === wanted.identification) ?? models[0];
  const model = await Model.of(await get(`/identifications/${chosen.id}`, {}, signal), wanted, signal);
  const inWords = (one) => [one.name || model.robot.name, ...one.added.map((choice) => `+ ${choiceInWords(model.effects, choice, model.joints)}`)].join(" ");
  const choice = select(models.map((one) => [one.id, `${inWords(one)}, ${moment(one.created_at)}`]), chosen.id, (id) => go({ view: "changes", identification: id }));
  const said = h("div");
  const result = h("div");
  const show = async (asked) => {
    put(result);
    try {
      const found = await awaited("/diagnoses", asked, "Comparing the days", said, signal);
      announce(found.result.summary);
      put(result, h("p", { class: "box" }, found.result.summary), changesTable(found));
    } catch (error) {
      if (!signal.aborted) put(said, problemBox(error));
    }
  };
  const form = changesForm(model, async (asked) => show(await post("/diagnoses", asked, { signal })), signal);
  form.open = true;
  put(target, h("h1", {}, "Changes"),
    h("div", { class: "bar-of-fields" }, field("Model", choice), h("a", { href: address({ identification: chosen.id }) }, `of ${model.robot.name}`)),
    section("since", "Between two days", form, said, result),
    daysSection(model, signal),
  );
  const latest = await newestOf("/diagnoses", { identification_id: chosen.id }, signal, (one) => one.request.baseline_ids.length > 0);
  if (latest) show(latest);
}

// Section on many days of a robot: changes with their first day, and parameters day by day.

import { get, post } from "./api.js";
import { shownChanges } from "./changes.js";
import { courseFigure } from "./parameter_over_days.js";
import { announce, h, put, section } from "./dom.js";
import { awaited, newestOf } from "./jobs.js";
import { orSay, sending } from "./problem.js";
import { byName, foldedTable } from "./tables.js";

/** Asks which measurement is of which day, and shows the newest series of the model. */
export function daysSection(model, signal) {
  const body = h("div", { id: "series" });
  const said = h("div");
  const state = { latest: null };

  async function known() {
    const newest = await newestOf("/series", { identification_id: model.id }, signal, (one) => one.status === "succeeded");
    if (!newest) return;
    // Lists have no tables.
    state.latest = await get(`/series/${newest.id}`, {}, signal);
    put(body, shown(state.latest, signal));
  }
  async function ask(asked) {
    const made = await post("/series", { identification_id: model.id, ...asked });
    state.latest = await awaited("/series", made, "Following the days", said, signal);
    put(body, shown(state.latest, signal));
    announce(state.latest.result.summary);
  }

  const choices = daysForm(model, state, ask, signal);
  orSay(said, known, signal);
  return section("days", "Over the days",
    h("p", { class: "note" }, "Recordings of the same robot on many days: what has changed, since which day, and each parameter day by day."),
    choices,
    said,
    body,
  );
}

/** Which measurement is of which day; those of the series that is there are kept and not read again. */
function daysForm(model, state, ask, signal) {
  const places = h("div", { class: "list-of-choices", id: "days-of-series" });
  const wrong = h("div");
  const days = new Map();
  const submit = h("button", { class: "main", id: "follow-days" }, "Follow the days");

  const fill = () => orSay(wrong, async () => {
    const { items } = await get("/measurements", { robot_id: model.robot.id, limit: 200 }, signal);
    const kept = await keptIn(state.latest, signal);
    const own = items.filter((one) => !kept.has(one.id)).reverse();
    days.clear();
    put(
      places,
      kept.size ? h("p", { class: "note" }, `${kept.size} recordings of the series below come first and are not read again.`) : null,
      own.length ? own.map((one, index) => line(one, index + 1)) : h("p", { class: "note" }, "Upload another day's recording to continue."),
    );
    submit.disabled = !own.length;
  }, signal);
  function line(one, day) {
    const control = h("input", { type: "number", min: 1, step: 1, value: day, id: `series-${one.id}`, class: "short" });
    days.set(one, control);
    return h("p", {}, h("label", { for: control.id }, one.name ?? one.id), " day ", control);
  }
  const send = sending(submit, wrong, async () => {
    await ask({ days: inOrder(days), continues: state.latest?.id ?? null });
    await fill();
  }, signal);
  const form = h("form", { onsubmit: send }, h("p", { class: "note" }, "Recordings with the same number are of one day; without a number they are left out."), places, h("p", { class: "actions" }, submit), wrong);
  return h("details", { id: "days-form", ontoggle: (event) => { if (event.target.open) fill(); } }, h("summary", {}, "Which recording is of which day?"), form);
}

/** Every measurement of a series and of those that it goes on from. */
async function keptIn(latest, signal) {
  const kept = new Set();
  for (let one = latest; one; one = one.request.continues ? await get(`/series/${one.request.continues}`, {}, signal) : null) {
    for (const day of one.request.days) for (const id of day.measurement_ids) kept.add(id);
  }
  return kept;
}

function inOrder(days) {
  const groups = new Map();
  for (const [measurement, control] of days) {
    if (control.value === "") continue;
    const day = Number(control.value);
    groups.set(day, [...(groups.get(day) ?? []), measurement.id]);
  }
  return [...groups.keys()].sort((a, b) => a - b).map((day) => ({ measurement_ids: groups.get(day) }));
}

function shown(series, signal) {
  const { result } = series;
  const { changes, tracks } = byName(series);
  return [
    h("p", { class: result.changes.length ? "box warning" : "box good", id: "series-summary" }, result.summary),
    changes ? shownChanges(changes, result) : null,
    courseFigure(result, signal),
    foldedTable(tracks),
  ];
}

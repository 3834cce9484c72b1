// Panel about one interval of a comparison: pose, speed, load, and effects that would explain the residual.

import { get, lastAsked } from "../api.js";
import { announce, figures, h, listed, numeric, put, right } from "../dom.js";
import { number, percent, positionUnit, quantity } from "../format.js";
import { byName, columnsOf, shownTable } from "../tables.js";
import { explainedShare } from "./explained_share.js";

const SHARE = 0.02; // of what is shown, to either side of a click
const MOST = 8; // candidates that are tried: those that a diagnosis ranks lower have no figure

/** A panel that is told of an interval of a joint. */
export class Moment {
  constructor(model, signal) {
    Object.assign(this, { model, signal, asking: lastAsked(signal) });
    this.element = h("div", { id: "moment" });
    model.addEventListener("diagnosis", () => this.shown && this.show(...this.shown));
    this.clear();
  }

  clear() {
    this.asking();
    this.shown = null;
    put(this.element, h("p", { class: "note" }, "Click an interval with a large residual to see pose, speed and load there, and effects that would explain it."));
  }

  /** Show what was at the moment where the joint's residual is largest between two times of its figure. */
  show(joint, { from, to }, lines) {
    const line = lines[joint];
    if (!line) return;
    const until = this.asking();
    const inside = indicesOf(line, from, to);
    if (!inside.length) return this.clear();
    this.shown = [joint, { from, to }, lines];
    const at = inside.reduce((best, one) => (Math.abs(line.values.residual[one]) > Math.abs(line.values.residual[best]) ? one : best));
    const { unit } = line;
    const words = `${joint}, ${number(line.x[inside[0]], 4)} to ${number(line.x[inside.at(-1)], 4)} s: the residual is largest at ${number(line.x[at], 4)} s, ${quantity(line.values.residual[at], unit)}`;
    const found = h("div", {}, h("p", { class: "note" }, "Looking for effects that would explain it …"));
    put(
      this.element,
      h("div", { class: "card", role: "region", "aria-label": "The interval" }, h("p", {}, h("strong", {}, words)), poseTable(this.model, lines, line.x[at]), found,
        h("p", { class: "actions" }, h("button", { type: "button", class: "small", onclick: () => this.clear() }, "Close"))),
    );
    announce(words);
    this.#explain(found, joint, line, inside, until);
  }

  async #explain(target, joint, line, inside, until) {
    const { diagnosis } = this.model;
    if (!diagnosis?.result) {
      put(target, h("p", { class: "note" }, "The model has no diagnosis yet. Diagnose it under Missing to see here which effects would explain this interval."));
      return;
    }
    const candidates = diagnosis.result.candidates.filter((one) => !one.joints.length || one.joints.includes(joint)).slice(0, MOST);
    const read = async (one) => {
      const evidence = await get(`/diagnoses/${diagnosis.id}/evidence`, { rank: one.rank, joint }, until).catch(() => null);
      return evidence && [one, explainedShare(evidence, line, inside), evidence.variable];
    };
    const all = (await Promise.all(candidates.map(read))).filter((one) => one && one[1] !== null);
    if (until.aborted) return;
    const helpful = all.filter(([, share]) => share > 0.01).sort((a, b) => b[1] - a[1]);
    const whose = diagnosis.request.identification_id === this.model.id ? "" : " The diagnosis is of an earlier model, without the effects added since.";
    if (!helpful.length) {
      put(target, h("p", {}, `No effect that the diagnosis ranks for ${joint} explains more than 1${"\u202f"}% of the squared residual in this interval.${whose}`));
      return;
    }
    const table = byName(diagnosis).candidates;
    const rows = helpful.map(([one]) => table.rows[diagnosis.result.candidates.indexOf(one)]);
    const more = [["seen over", (k) => helpful[k][2]], [right("share of this interval"), (k) => numeric(percent(helpful[k][1], 2), helpful[k][1])]];
    put(target, shownTable({ ...columnsOf({ ...table, rows }, [1, 2, 8]), title: "Effects that would explain it", notes: [], marked_rows: [] }, { id: "explained" }, { more }),
      h("p", { class: "note" }, `Share: the part of the squared residual in this interval that the effect's fitted curve explains.${whose}`));
  }
}

/** The interval that is meant by a click. */
export function around(time, view) {
  const reach = SHARE * (view.range.to - view.range.from);
  return { from: time - reach, to: time + reach };
}

function indicesOf(line, from, to) {
  return line.x.map((_, index) => index).filter((index) => line.x[index] >= from && line.x[index] <= to && line.values.residual[index] !== null);
}

function poseTable(model, lines, time) {
  const column = (head, name, suffix = null) => figures(head, (joint) => {
    const { x, values } = lines[joint];
    return values[name]?.[nearest(x, values.q, time)] ?? null;
  }, (value, joint) => quantity(value, suffix === null ? lines[joint].unit : `${positionUnit(lines[joint].unit)}${suffix}`));
  const columns = [["joint", (joint) => joint], column("position", "q", ""), column("speed", "dq", "/s"), column("load of the rigid body", "load"), column("measured", "measured"), column("residual", "residual")];
  return listed(`All joints at ${number(time, 4)} s`, columns, model.joints.filter((joint) => lines[joint]), { id: "pose" });
}

function nearest(x, values, time) {
  let best = 0;
  x.forEach((one, index) => {
    if (values[index] !== null && Math.abs(one - time) < Math.abs(x[best] - time)) best = index;
  });
  return best;
}

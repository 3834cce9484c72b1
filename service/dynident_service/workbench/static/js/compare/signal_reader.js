// Reads the signals of a comparison for the visible interval of time (1,200 points).

import { get, lastAsked } from "../api.js";
import { timeline } from "../timeline.js";

const POINTS = 1200;
const SIGNALS = ["measured", "predicted", "lower", "upper", "standing", "residual", "band", "q", "dq", "ddq", "load"];

/**
 * Tells `onLine(joint, line)` as each joint's signals come, `line.interval` being what was read (null: all); of several
 * intervals only the last is read to its end.
 */
export class Reader {
  constructor(comparison, joints, onLine, signal) {
    Object.assign(this, { comparison, joints, onLine, signal, full: {}, filling: null });
    this.asking = lastAsked(signal);
  }

  /** Whether runs that overlap in time are set one after another. */
  get shifted() {
    return Object.values(this.full).some((one) => one.shifted);
  }

  get isFull() {
    return this.joints.every((joint) => this.full[joint]);
  }

  /** Read an interval, null for all, the `first` joint before the others. */
  async read(stretch, first) {
    const until = this.asking();
    // What was read whole is shown at once; runs set one after another have no time of their own to ask for.
    if (this.isFull && (!stretch || this.shifted)) {
      for (const joint of this.joints) this.onLine(joint, this.full[joint]);
      return;
    }
    const one = async (joint) => {
      const line = await this.#one(joint, stretch, until);
      if (!line) return;
      if (!stretch) this.full[joint] = line;
      this.onLine(joint, line);
    };
    await one(first);
    await Promise.all(this.joints.filter((joint) => joint !== first).map(one));
  }

  /** Read all that there is while something else is shown. */
  async fill() {
    if (this.isFull) return;
    this.filling ??= Promise.all(this.joints.map(async (joint) => { this.full[joint] ??= await this.#one(joint, null, this.signal); }));
    await this.filling.finally(() => { this.filling = null; });
  }

  async #one(joint, stretch, until) {
    const query = { joint, points: POINTS, ...(stretch ?? {}) };
    try {
      const series = await get(`/comparisons/${this.comparison.id}/series`, query, until);
      if (until.aborted) return null;
      const line = timeline(series, SIGNALS.filter((name) => series[name]?.length));
      return Object.assign(line, { unit: series.effort_unit, samples: series.n_samples, stretch });
    } catch (error) {
      if (until.aborted) return null;
      throw error;
    }
  }
}

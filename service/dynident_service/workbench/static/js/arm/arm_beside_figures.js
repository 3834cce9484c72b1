// The arm beside figures over time: its posture at the cursor; loaded when opened.

import { h, put } from "../dom.js";
import { problemBox } from "../problem.js";

const FRAMES = 1500;

/**
 * A part of a page to be opened. `motion()` gives [{ t, q }] of the robot's joints (s, rad or m, q null where there is
 * no sample), [] where the robot only stands, or null as long as nothing is known; the arm follows the "cursor" events of `view`.
 */
export function armBeside({ robotId, view, motion, props = { class: "arm-beside" } }, signal) {
  const place = h("div");
  let mounted = null;
  let turn = 0; // of those who mount an arm the last one has its way
  let mounting = false;
  const open = async () => {
    if (!element.open || mounted || mounting) return;
    const joints = motion();
    if (!joints) return void put(place, h("p", { class: "note" }, "The signals are still being read …"));
    const mine = turn;
    mounting = true;
    try {
      const { mountArm } = await import("./arm.js");
      const made = await mountArm(h("div"), { robotId, ...(joints.length ? together(joints) : {}), signal });
      if (mine !== turn) return;
      mounted = made;
      put(place, made.element);
      if (view.at !== undefined) mounted.show(view.at);
    } catch (error) {
      if (!signal.aborted && mine === turn) put(place, problemBox(error, open));
    } finally {
      if (mine === turn) mounting = false;
    }
  };
  view.addEventListener("settled", open, { signal });
  view.addEventListener("cursor", () => mounted?.show(view.at), { signal });
  const element = h("details", { ...props, ontoggle: open }, h("summary", {}, "The arm at the moment under the cursor"), place);
  return {
    element,
    /** Other signals are shown: the arm is that of these. */
    forget() {
      turn += 1;
      mounting = false;
      mounted = null;
      put(place);
      open();
    },
  };
}

/** Postures at the times of the joint with most of them, each joint where it was last. */
function together(joints) {
  const longest = joints.reduce((most, one) => (one.t.length > most.t.length ? one : most));
  const step = Math.max(1, Math.floor(longest.t.length / FRAMES));
  const times = longest.t.filter((_, index) => index % step === 0);
  const last = joints.map(() => 0);
  const known = joints.map(({ q }) => q.find((value) => value !== null) ?? 0);
  const positions = times.map((time) => joints.map(({ t, q }, joint) => {
    while (last[joint] < t.length && t[last[joint]] <= time) {
      known[joint] = q[last[joint]] ?? known[joint];
      last[joint] += 1;
    }
    return known[joint];
  }));
  return { times, positions };
}

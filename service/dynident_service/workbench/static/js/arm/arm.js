// The moving arm on a canvas: turned by dragging, with a slider of time.

import { get, post } from "../api.js";
import { h, put } from "../dom.js";
import { quantity } from "../format.js";
import { onColours } from "../plots.js";
import { draw } from "./drawing.js";
import { outlinesOf } from "./clearances.js";
import { BASE, origin, segmentsAt, surfacesAt } from "./kinematics.js";

const POSES_OF_PATH = 300;
const STEP = 0.12; // rad a key

/**
 * Show a robot's motion in `element`.
 *
 * `times` (s) and `positions` ([sample][joint], rad or m) are those of its joints in the robot's order. Gives
 * { show(time), surround(clearances), keepClear(clearances), element }; `onTime(time)` is told when a person moves the arm to another time.
 * Without `positions` the arm stands at zero, or where its loops are closed. `floor` is the height of one (m). Nothing goes on after `signal` aborts.
 */
export async function mountArm(element, { robotId, times = [0], positions = null, floor = null, onTime = () => {}, signal = undefined }) {
  const geometry = await get(`/robots/${robotId}/geometry`, {}, signal);
  const motion = positions ?? [geometry.joints.map((_, k) => geometry.closed[k] ?? 0)];
  const { poses } = await post(`/robots/${robotId}/poses`, { positions: motion }, { signal });
  const state = { time: times[0], playing: null, view: { turn: 0.6, tilt: 0.35, ...extent(geometry, poses, floor) } };
  const path = some(poses).map((frames) => frames.findLast(Boolean)).filter(Boolean).map(origin);
  let outlines = [];
  const near = h("p", { class: "note", id: "nearest-now", hidden: true });
  let clearances = null;
  const canvas = h("canvas", { class: "arm", tabindex: "0", role: "img", "aria-label": "The arm. Drag or use the arrow keys to turn it; plus and minus change its size." });
  const slider = h("input", { type: "range", min: times[0], max: times.at(-1), step: "any", value: times[0], "aria-label": "Time in s", oninput: () => moved(Number(slider.value)) });
  const clock = h("output", { class: "note" });
  const play = h("button", { type: "button", class: "small", onclick: () => (state.playing ? stop() : start()) }, "Play");

  function show(time) {
    state.time = Math.min(Math.max(time, times[0]), times.at(-1));
    slider.value = state.time;
    clock.textContent = quantity(state.time, "s");
    const frames = poses[before(times, state.time)];
    canvas.dataset.origins = JSON.stringify(frames.map((pose) => pose && origin(pose)));
    const parts = { surfaces: surfacesAt(geometry, frames), segments: segmentsAt(geometry, frames, 0.025 * state.view.reach) };
    canvas.dataset.triangles = parts.surfaces.reduce((sum, one) => sum + one.triangles.length, 0);
    const { lines, words } = clearances?.at(state.time, frames) ?? { lines: [], words: "" };
    canvas.dataset.floor = floor ?? "";
    canvas.dataset.gaps = JSON.stringify(lines.map((one) => one.ends));
    near.firstChild?.replaceWith(`${words} `);
    draw(canvas, state.view, { ...parts, frames: [BASE, ...frames], path, around: { floor, outlines }, gaps: lines });
  }

  function moved(time) {
    show(time);
    onTime(state.time);
  }

  /** Draw what stands around the robot, as GET /v1/designs/{id}/clearances has it. */
  function surround(found) {
    outlines = outlinesOf(found, state.view.reach);
    show(state.time);
  }

  /** Draw what the links are near to along the motion, as it is known (see clearances.js). */
  function keepClear(known) {
    clearances = known;
    near.hidden = false;
    put(near, " ", h("button", { type: "button", class: "small", onclick: () => moved(known.nearest) }, `Closest approach: at ${quantity(known.nearest, "s")}`));
    show(state.time);
  }

  function start() {
    const from = state.time >= times.at(-1) ? times[0] : state.time;
    const began = performance.now();
    play.textContent = "Pause";
    const next = (now) => {
      if (signal?.aborted || !canvas.isConnected) return;
      const time = from + (now - began) / 1000;
      moved(time);
      if (time >= times.at(-1)) stop();
      else state.playing = requestAnimationFrame(next);
    };
    state.playing = requestAnimationFrame(next);
  }

  function stop() {
    cancelAnimationFrame(state.playing);
    state.playing = null;
    play.textContent = "Play";
  }

  const turn = (right, up) => {
    state.view.turn -= right;
    state.view.tilt = Math.min(Math.max(state.view.tilt + up, -1.57), 1.57);
    show(state.time);
  };
  const size = (factor) => {
    state.view.reach *= factor;
    show(state.time);
  };
  const keys = { ArrowLeft: () => turn(-STEP, 0), ArrowRight: () => turn(STEP, 0), ArrowUp: () => turn(0, STEP), ArrowDown: () => turn(0, -STEP), "+": () => size(0.8), "-": () => size(1.25) };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turn(event.movementX / 120, event.movementY / 120);
  });

  const open = poses.some((frames) => frames.includes(null));
  const notes = [
    geometry.capsules.length || geometry.surfaces.length ? "" : "No collision geometry could be read: rods show the links.",
    open ? "At some times of this motion the loops cannot be closed: their links are not drawn there." : "",
  ].filter(Boolean).join(" ");
  put(element, canvas, h("p", { class: "arm-time" }, times.length > 1 ? [play, slider, clock] : null), near,
    h("p", { class: "note" }, "Axes x, y, z are orange, green, blue; the line is the path of the last joint's origin. Drag to rotate. ", notes));
  const observer = new ResizeObserver(() => canvas.clientWidth && show(state.time));
  observer.observe(canvas);
  signal?.addEventListener("abort", () => observer.disconnect());
  onColours(() => show(state.time), signal);
  show(state.time);
  return { show, surround, keepClear, element };
}

/** The last sample that is not after a time. */
function before(times, time) {
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

function some(motion) {
  const step = Math.max(1, Math.floor(motion.length / POSES_OF_PATH));
  return motion.filter((_, index) => index % step === 0);
}

/** Middle and reach of all that the motion sweeps, and of the floor (m) below the base: the ball about the middle that holds it. */
function extent(geometry, poses, floor) {
  const boxes = { surfaces: geometry.surfaces.map((one) => ({ ...one, points: cornersOf(one.points) })) };
  const swept = some(poses).flatMap((frames) => {
    const ends = segmentsAt(geometry, frames, 0.02).flatMap(({ start, end, radius }) => [[start, radius], [end, radius]]);
    return [...ends, ...surfacesAt(boxes, frames).flatMap(({ points }) => points.map((point) => [point, 0]))];
  });
  if (floor !== null) swept.push([[0, 0, floor], 0]);
  const middle = [0, 1, 2].map((k) => {
    const [low, high] = swept.reduce(([least, most], [point, radius]) => [Math.min(least, point[k] - radius), Math.max(most, point[k] + radius)], [Infinity, -Infinity]);
    return (low + high) / 2;
  });
  const reach = swept.reduce((most, [point, radius]) => Math.max(most, Math.hypot(...point.map((value, k) => value - middle[k])) + radius), 0.1);
  return { middle, reach };
}

/** The corners of the box around points: enough of a mesh to know how far it reaches. */
function cornersOf(points) {
  const ends = [0, 1, 2].map((k) => points.reduce(([least, most], point) => [Math.min(least, point[k]), Math.max(most, point[k])], [Infinity, -Infinity]));
  return ends[0].flatMap((x) => ends[1].flatMap((y) => ends[2].map((z) => [x, y, z])));
}

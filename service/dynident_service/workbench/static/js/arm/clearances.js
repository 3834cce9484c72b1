// What stands around a moving arm: its outlines, and the bodies nearest to the links as lines and in words.

import { quantity } from "../format.js";
import { BASE, placed } from "./kinematics.js";

const LINES = [-1, -0.5, 0, 0.5, 1]; // of a wall, across and along, in shares of the reach
const FAR = 0.3; // m: what is farther off than that, and not the nearest of all, is no line

/** Along a motion as GET /v1/designs/{id}/clearances gives it: { at(time, frames), nearest }, `nearest` being when (s). */
export function clearancesOf({ t, links }) {
  const room = (link, k) => link.distance[k] - link.wanted[k];
  const tightest = (k) => links.reduce((best, one) => (!best || room(one, k) < room(best, k) ? one : best), null);
  const rooms = t.map((_, k) => (links.length ? room(tightest(k), k) : 0));
  const at = (time, frames) => {
    const k = sampleAt(t, time);
    const worst = tightest(k);
    const drawn = links.filter((one) => one === worst || one.distance[k] < FAR);
    const lines = drawn.flatMap((one) => {
      const other = one.others[one.to[k]];
      const poses = [one.frame, other.frame].map((frame) => (frame === null ? BASE : frames[frame]));
      if (!poses.every(Boolean)) return []; // a closed loop moves it: it is not drawn
      const ends = [placed(poses[0], one.here[k]), placed(poses[1], one.there[k])];
      return [{ ends, text: one === worst ? quantity(one.distance[k], "m") : "", nearest: one === worst }];
    });
    return { lines, words: worst ? inWords(worst, k) : "" };
  };
  return { at, nearest: t[rooms.indexOf(Math.min(...rooms))] };
}

function inWords(link, k) {
  return `Closest here: ${link.name} and ${link.others[link.to[k]].name}, ${quantity(link.distance[k], "m")} apart; required: ${quantity(link.wanted[k], "m")}.`;
}

/** The nearest sample: those of the clearances are fewer than those of the motion. */
function sampleAt(t, time) {
  let [low, high] = [0, t.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle;
    else high = middle;
  }
  return time - t[low] <= t[high] - time ? low : high;
}

/** [[point, point]] of what GET /v1/designs/{id}/clearances has of the surroundings; walls reach as far as `reach` (m). */
export function outlinesOf({ edges, walls }, reach) {
  return [...edges, ...walls.flatMap((wall) => grid(wall, reach))];
}

function grid({ point, along: [u, v] }, reach) {
  const at = (a, b) => point.map((value, k) => value + reach * (a * u[k] + b * v[k]));
  return LINES.flatMap((k) => [[at(k, -1), at(k, 1)], [at(-1, k), at(1, k)]]);
}

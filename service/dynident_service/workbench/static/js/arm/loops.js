// Closed loops: the passive positions at which the two sides of every cut joint meet, by Newton's method.

import { BASE, flat, framesAt, times } from "./kinematics.js";

const CLOSED = 1e-7; // m, rad: far below what a picture shows
const NUDGE = 1e-6; // of a passive position, for the slopes
const WAY = 0.1; // rad or m that a joint moves at a time, so that the branch is kept
const MOST_STEPS = 12;

/**
 * A robot's `followed(positions)`: its joints' positions with the passive ones behind them, or without where the loops
 * cannot be closed. Each posture is reached from the one before.
 */
export function loopsOf(geometry) {
  const joints = geometry.joints.length;
  if (!geometry.loops.length) return (positions) => positions;
  let last = geometry.closed;

  return (positions) => {
    const way = Math.max(...positions.map((value, k) => Math.abs(value - last[k])));
    const steps = Math.max(1, Math.ceil(way / WAY));
    let passive = last.slice(joints);
    const from = last.slice(0, joints);
    for (let step = 1; step <= steps; step += 1) {
      const there = positions.map((value, k) => from[k] + ((value - from[k]) * step) / steps);
      passive = closedAt(geometry, there, passive);
      if (!passive) return positions;
      last = [...there, ...passive];
    }
    return [...positions, ...passive];
  };
}

/** Passive positions near a guess that close the loops; null where none are found. */
function closedAt(geometry, positions, guess) {
  let passive = guess;
  for (let step = 0; step < MOST_STEPS; step += 1) {
    const gaps = gapsAt(geometry, [...positions, ...passive]);
    if (Math.max(...gaps.map(Math.abs)) < CLOSED) return passive;
    const slopes = passive.map((_, k) => {
      const nudged = passive.map((value, place) => value + (place === k ? NUDGE : 0));
      return gapsAt(geometry, [...positions, ...nudged]).map((gap, row) => (gap - gaps[row]) / NUDGE);
    });
    const change = leastSquares(slopes, gaps);
    if (!change) return null;
    passive = passive.map((value, k) => value - change[k]);
  }
  return null;
}

/** How far the two sides of each loop are apart. */
function gapsAt(geometry, positions) {
  const frames = framesAt(geometry, positions);
  return geometry.loops.flatMap(({ kind, ends }) => {
    const [first, second] = ends.map(({ frame, placement }) => times(frame === null ? BASE : frames[frame], flat(placement)));
    const apart = [3, 7, 11].map((k) => second[k] - first[k]);
    const column = (pose, k) => [pose[k], pose[k + 4], pose[k + 8]];
    if (kind === "planar") return [0, 1].map((k) => dot(column(first, k), apart));
    if (kind === "point") return apart;
    const turned = (row, k) => dot(column(first, row), column(second, k));
    return [...apart, ...[[2, 1], [0, 2], [1, 0]].map(([row, k]) => 0.5 * (turned(row, k) - turned(k, row)))];
  });
}

/** x that makes the columns times x come nearest to the values: equations of a loop may say the same thing twice. */
function leastSquares(columns, values) {
  const rows = columns.map((one) => [...columns.map((other) => dot(one, other)), dot(one, values)]);
  for (let k = 0; k < rows.length; k += 1) {
    const best = rows.reduce((most, row, place) => (place >= k && Math.abs(row[k]) > Math.abs(rows[most][k]) ? place : most), k);
    [rows[k], rows[best]] = [rows[best], rows[k]];
    if (Math.abs(rows[k][k]) < 1e-12) return null;
    for (const [place, row] of rows.entries()) {
      if (place === k) continue;
      const share = row[k] / rows[k][k];
      for (let column = k; column < row.length; column += 1) row[column] -= share * rows[k][column];
    }
  }
  return rows.map((row, k) => row.at(-1) / row[k]);
}

function dot(a, b) {
  return a.reduce((sum, value, k) => sum + value * b[k], 0);
}

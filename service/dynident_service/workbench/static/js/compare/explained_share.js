// Compute how much of the residual in an interval the curve of a ranked effect explains.

const SIGNALS = { position: "q", velocity: "dq", acceleration: "ddq", load: "load", time: null };

/**
 * The share of the squares of a line's residual at `inside` that the curve of `evidence` takes; below zero where it
 * makes them larger. null where the curve is over something that the line has not.
 */
export function explainedShare({ variable, x, fitted }, line, inside) {
  if (!(variable in SIGNALS)) return null;
  const over = variable === "time" ? line.times : line.values[SIGNALS[variable]];
  if (!over) return null;
  let before = 0;
  let after = 0;
  for (const index of inside) {
    const residual = line.values.residual[index];
    before += residual ** 2;
    after += (residual - valueAt(x, fitted, over[index])) ** 2;
  }
  return before > 0 ? 1 - after / before : null;
}

/** The curve at a place, on a straight line between its points; outside as at its ends. */
function valueAt(x, y, place) {
  const next = x.findIndex((one) => one >= place);
  if (next < 0) return y.at(-1);
  if (next === 0) return y[0];
  const share = (place - x[next - 1]) / (x[next] - x[next - 1] || 1);
  return y[next - 1] + share * (y[next] - y[next - 1]);
}

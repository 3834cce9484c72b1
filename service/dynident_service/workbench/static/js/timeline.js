// Turns a series of the API into plot data: increasing time, gaps.

/**
 * Runs that overlap in time are set one after another (`shifted`). Gives { x, values: { name: array }, shifted,
 * times (the recording's own time of each x, null in gaps) }.
 */
export function timeline(series, names) {
  const steps = series.t.slice(1).map((t, index) => t - series.t[index]);
  const usual = median(steps.filter((step, index) => step > 0 && series.segment[index] === series.segment[index + 1]));
  const x = [];
  const times = [];
  const values = Object.fromEntries(names.map((name) => [name, []]));
  let shift = 0;
  let shifted = false;
  series.t.forEach((t, index) => {
    const broken = index > 0 && series.segment[index] !== series.segment[index - 1];
    if (index > 0 && t + shift <= x.at(-1)) {
      shift = x.at(-1) + 5 * usual - t;
      shifted = true;
    }
    if (broken) {
      x.push((x.at(-1) + t + shift) / 2);
      times.push(null);
      for (const name of names) values[name].push(null);
    }
    x.push(t + shift);
    times.push(t);
    for (const name of names) values[name].push(series[name][index]);
  });
  return { x, times, values, shifted };
}

/** Where the interval [from, to] of the recording's time is on the axis; the worst of several, by `size`. */
export function find(line, from, to, size) {
  let best = null;
  let open = null;
  line.times.forEach((time, index) => {
    if (time !== null && time >= from && time <= to) {
      open ??= { from: line.x[index], to: line.x[index], size: 0 };
      open.to = line.x[index];
      open.size = Math.max(open.size, Math.abs(size[index]));
      if (!best || open.size > best.size) best = open;
    } else open = null;
  });
  return best;
}

function median(values) {
  return values.length ? [...values].sort((a, b) => a - b)[values.length >> 1] : 1;
}

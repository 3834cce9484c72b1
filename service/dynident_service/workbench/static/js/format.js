// Numbers as text: digits, units, percentages (the rules of `number_format.py`).

const SPACE = "\u202f";
const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";

/** A number with so many significant digits; "–" where there is none. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e6) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    return minus(`${mantissa}·10${superscript(Number(exponent))}`);
  }
  return minus(value.toFixed(decimals(value, digits)));
}

/** A number with its unit. */
export function quantity(value, unit, digits = 3) {
  const figure = number(value, digits);
  return figure === "–" || unit === "-" || !unit ? figure : `${figure}${SPACE}${unit}`;
}

/** A value with its standard deviation, both with as many decimals. */
export function estimated(value, deviation) {
  if (!(deviation >= 1e-9) || Math.abs(value) >= 1e6) return `${number(value)} ± ${deviation === null ? "?" : number(deviation, 2)}`;
  const places = decimals(deviation, 2);
  return minus(`${value.toFixed(places)} ± ${deviation.toFixed(places)}`);
}

/** A fraction as per cent. */
export function percent(fraction, digits = 3) {
  if (fraction === null || fraction === undefined || Number.isNaN(fraction)) return "–";
  if (fraction > 10) return `> 1000${SPACE}%`;
  const scaled = 100 * fraction;
  if (Math.abs(scaled) < 0.0005) return `0${SPACE}%`;
  return minus(scaled.toFixed(Math.min(3, decimals(scaled, digits)))) + `${SPACE}%`;
}

/** The ends of an interval, with as many decimals as tell them apart. */
export function interval(low, high, unit) {
  if (low === null || high === null) return "–";
  const size = Math.max(Math.abs(low), Math.abs(high));
  if (size < 1e-4 || size >= 1e6) return `${number(low)} to ${quantity(high, unit)}`;
  let places = decimals(size, 3);
  while (places < 9 && low !== high && low.toFixed(places) === high.toFixed(places)) places += 1;
  return minus(`${low.toFixed(places)} to ${high.toFixed(places)}`) + (unit === "-" || !unit ? "" : `${SPACE}${unit}`);
}

/** A count with its noun. */
export function counted(count, noun, plural = `${noun}s`) {
  return `${grouped(count)} ${count === 1 ? noun : plural}`;
}

/** A whole number in groups of three digits. */
export function grouped(count) {
  return String(count).replace(/\B(?=(\d{3})+$)/g, SPACE);
}

/** A moment as people say it. */
export function moment(text) {
  const then = new Date(text);
  const time = then.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  const today = new Date().toDateString() === then.toDateString();
  return today ? `today ${time}` : `${then.toLocaleDateString([], { dateStyle: "medium" })} ${time}`;
}

/** The unit of a joint's position, from the unit of its effort. */
export function positionUnit(effortUnit) {
  return effortUnit === "N m" ? "rad" : "m";
}

function decimals(value, digits) {
  return Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value))));
}

function minus(text) {
  return text.replaceAll("-", "−");
}

function superscript(exponent) {
  return String(exponent).replace("-", "⁻").replace(/\d/g, (digit) => SUPERSCRIPTS[digit]);
}

"use strict";

/** Round steps: about `count` numbers from `low` to `high`. */
function steps(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((m) => m * power).find((s) => s >= raw * 0.999) || raw;
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
}

/** A number for people: so many digits that neighbours differ. */
function told(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) {
    const [digit, exponent] = value.toExponential(digits - 1).split("e");
    return `${digit.replace("-", "−")}·${power(10 ** Number(exponent))}`;
  }
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}

/** Powers of ten within two positive numbers, no more than about six. */
function powers(low, high) {
  const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
  const every = Math.max(1, Math.ceil((last - first + 1) / 6)), found = [];
  for (let k = last; k >= first; k -= every) found.push(10 ** k);
  return found;
}

/** The power of ten to take out of numbers up to `size`; 0 for those that are written out. */
const common = (size) => (size > 0 && (size < 1e-2 || size >= 1e5) ? Math.floor(Math.log10(size)) : 0);

const power = (value) => `${value < 0 ? "−" : ""}10${String(Math.round(Math.log10(Math.abs(value)))).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] || "⁻")}`;

/** How values become heights: `to` a number that is drawn evenly, `ticks` of [value, text] between two values. */
const scales = {
  linear: (low, high) => {
    const exponent = common(Math.max(Math.abs(low), Math.abs(high)));
    const ticks = steps(low, high, 5).map((v) => [v, told(v / 10 ** exponent)]);
    return { to: (v) => v, ticks: () => ticks, note: exponent ? power(10 ** exponent) : "" };
  },
  log: () => ({ to: (v) => (v > 0 ? Math.log10(v) : NaN), ticks: (low, high) => powers(low, high).map((v) => [v, power(v)]) }),
  symlog: (low, high) => {
    const least = 1e-5 * (Math.max(Math.abs(low), Math.abs(high)) || 1);
    const both = (size) => (size > least ? powers(least, size).filter((v) => v > 2 * least) : []);
    const kept = (list) => list.filter((_, i) => i % 2 === 0);
    return {
      to: (v) => Math.asinh(v / least),
      ticks: () => [...kept(both(-low)).map((v) => [-v, power(-v)]), [0, "0"], ...kept(both(high)).map((v) => [v, power(v)])],
    };
  },
};

/** The first place in a rising array whose number is not below `value`. */
function placeOf(array, value) {
  let low = 0, high = array.length;
  while (low < high) { const middle = (low + high) >> 1; if (array[middle] < value) low = middle + 1; else high = middle; }
  return low;
}

/** The place of the nearest number in a rising array. */
function nearest(array, value) {
  const at = Math.min(placeOf(array, value), array.length - 1);
  return at > 0 && value - array[at - 1] < array[at] - value ? at - 1 : at;
}

// Numbers, units and times as text.

/** Four significant digits, a small number without an exponent, thousands apart; a dash where there is no number. */
function num(value, digits = 4) {
  if (value === null || value === undefined) return "\u2013";
  const size = Math.abs(value);
  if (size > 1e-10 && size < 1e-4) return plainly(value, digits - 1 - Math.floor(Math.log10(size)));
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(digits - 1);
  return thousands(String(Number(value.toPrecision(digits))));
}

/** A number as text, with its thousands apart: "-1,234.5678". */
function thousands(text) {
  const [whole, ...after] = text.split(".");
  return [whole.replace(/\B(?=(\d{3})+$)/g, ","), ...after].join(".");
}

/** A unit for text; "1" is none. */
function unitText(unit) {
  return unit === "1" || !unit ? "" : short(unit, 12);
}

/** A number with its unit. */
function quantity(value, unit, digits = 4) {
  return value === null || value === undefined ? num(value) : `${num(value, digits)} ${unitText(unit)}`.trimEnd();
}

/** "phi (rad)". */
function withUnit(name, unit) {
  return short(name, 40) + (unitText(unit) && ` (${unitText(unit)})`);
}

/** Four decimals, more next to 0 or 1, rounded to the safe side: down for ">=", up for "<="; as `outward` of bound_text.py. */
function outward(value, sense) {
  if (value === null || value === undefined) return num(value);
  const distance = Math.min(Math.abs(value), Math.abs(1 - value));
  const digits = distance > 1e-10 && distance < 1e-3 ? 2 - Math.floor(Math.log10(distance)) : 4;
  const scaled = value * 10 ** digits;
  const nearest = Math.round(scaled);
  const exact = Math.abs(scaled - nearest) <= Math.max(1e-6, Math.abs(scaled) * 4e-16);
  const kept = exact ? nearest : sense === ">=" ? Math.floor(scaled) : Math.ceil(scaled);
  return plainly(kept / 10 ** digits, digits);
}

/** A number with so many decimals at most, and four at least. */
function plainly(value, digits) {
  const [whole, after] = value.toFixed(digits).split(".");
  return `${whole}.${after.replace(/0+$/, "").padEnd(4, "0")}`;
}

/** A bound with its unit, rounded to the safe side. */
function boundText(value, sense, unit) {
  return `${outward(value, sense)} ${unitText(unit)}`.trimEnd();
}

/** A count, "6,000". */
function count(value) {
  return value.toLocaleString("en-GB");
}

/** "1 test", "2 tests". */
function plural(value, word) {
  return `${count(value)} ${word}${value === 1 ? "" : "s"}`;
}

/** "x = 5 m, y = 0 m". */
function place(x, axes) {
  const part = (value, k) => `${axes[k] ? `${shortMiddle(axes[k].name, 24)} = ` : ""}${quantity(value, axes[k]?.unit)}`;
  return [...x.flatMap((value, k) => (axes[k]?.signal ? [] : [part(value, k)])), ...longInputs(axes)].join(", ");
}

/** The numbers of the axes that are read one by one: not those of an input over time that has many. */
function readAxes(report) {
  return report.axes.map((_, k) => k).filter((k) => !report.axes[k].signal);
}

/** "push over time (1,000 parameters)" for each input that is read as a curve. */
function longInputs(axes) {
  const names = axes.map(({ signal }) => signal).filter(Boolean);
  return [...new Set(names)].map((name) => `${short(name, 24)} over time (${plural(names.filter((each) => each === name).length, "parameter")})`);
}

/** A duration: "95 s", "12 min", "3.4 h". */
function duration(seconds) {
  if (seconds < 120) return `${num(seconds, 3)} s`;
  return seconds < 7200 ? `${num(seconds / 60, 3)} min` : `${num(seconds / 3600, 3)} h`;
}

/** The age of a Unix time at `now`. */
function ago(time, now) {
  return time === null ? "never" : `${Math.max(0, Math.round(now - time))} s ago`;
}

/** A Unix time as UTC to the second. */
function utc(time) {
  return time === null ? num(null) : `${new Date(time * 1000).toISOString().slice(0, 19).replace("T", " ")} UTC`;
}

/** ASCII notation of sentences in a certificate, and its typeset form. */
const NOTATION = [["rho*", "\u03c1*"], [" -+", " \u2213"], [" -", " \u2212"], [">= ", "\u2265\u00a0"], ["<= ", "\u2264\u00a0"], ["F_i", "F\u1d62"]];

/** A sentence in typeset form, cut where it is too long. */
function sentence(text, longest = 1200) {
  return NOTATION.reduce((found, [ascii, typeset]) => found.replaceAll(ascii, typeset), short(text, longest));
}

/** A name of a schema as words: "nominal_robustness" -> "nominal robustness". */
function words(name) {
  return short(name).replaceAll("_", " ");
}

/** Least and greatest number of some lists, or null if they are empty. */
function extent(...lists) {
  let [low, high] = [Infinity, -Infinity];
  for (const list of lists) {
    for (const value of list) {
      if (value === null || value === undefined) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return low > high ? null : [low, high];
}

/** About `wanted` round numbers from `low` to `high`, as [number, text]. */
function ticks(low, high, wanted) {
  const raw = (high - low) / wanted || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw * 0.999);
  const found = [];
  const decimals = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 12);
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k += 1) found.push([k * step, thousands((k * step).toFixed(decimals))]);
  return found;
}

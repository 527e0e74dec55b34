// Charts of a problem over its tests: the bounds with what is required of them, and the convergence.

const MOST_CUT = 0.35; // early bounds are shown as far beyond the other values as this share of their range
const MOST_LATE = 1; // those of the later three quarters of the tests as far as this share
const NEAR_CLIP = 0.15; // an end of the clip is shown that is as far beyond them at most
const HARMLESS = 0.95; // share of the observed values, the worst ones, that the picture has at least
const CHART = { height: 240, decay: 180 }; // pixels

/** The names of the series of the bounds, by their side. */
function boundNames(problem) {
  const of = drawsStarts(problem) ? "the claimed quantity" : problem.sense === "max" ? "the largest value" : "the worst start";
  const limit = problem.method === "scenario" ? `the bound on ${of} cannot become better than this` : null;
  const names = { lower: `lower bound of the method on ${of}`, upper: `upper bound of the method on ${of}` };
  return limit === null ? names : { ...names, [claimedSide(problem) === "lower" ? "upper" : "lower"]: limit };
}

/** The side of the bounds that is claimed. */
function claimedSide(problem) {
  return problem.sense === "max" ? "upper" : "lower";
}

/** Whether there is a convergence to draw: the bounds of a requirement are not recorded after each test. */
function converges(problem) {
  return problem.alpha !== null && problem.requirement === null;
}

/** The observed values that a chart of the bounds has; a probability has another axis than the robustness. */
function observedBesideBounds(problem) {
  const { y } = problem.tests;
  return observesRobustness(problem) && problem.sense === "max" ? y.map(() => null) : y;
}

function boundFigure(report, problem, index) {
  const has = (values) => values.some((value) => value !== null);
  const { lower, upper } = problem.tests;
  const names = boundNames(problem);
  const claimed = claimedSide(problem);
  const other = claimed === "lower" ? "upper" : "lower";
  const observed = observedBesideBounds(problem);
  const violates = problem.charts.of_robustness && observed.some((value) => value !== null && value < 0);
  return chartFigure(
    `bound-${index}`,
    boundTitle(problem),
    el(
      "ul.legend",
      has({ lower, upper }[claimed]) ? legendItem("key.claimed", `${names[claimed]}: what is claimed`) : null,
      has({ lower, upper }[other]) ? legendItem("key.opposite", names[other]) : null,
      has(observed) ? legendItem("key.observed", `observed value of each test${violates ? " (red: below 0, a violation)" : ""}`) : null,
    ),
    el(`p.readout#read-bound-${index}`, { "data-keep": true }, "Point at the chart to read the values of a test."),
    caption(boundCaption(report, problem)),
  );
}

function boundTitle(problem) {
  if (problem.requirement !== null) return "Observed values of the tests"; // its bounds were not recorded
  if (drawsStarts(problem)) return "The bound of the first claim after each sample";
  return `Bounds on the ${problem.sense === "max" ? "maximum" : "minimum"} after each test`;
}

/** What the chart of the bounds shows, where the problem stopped and why, and what is outside of the picture. */
function boundCaption(report, problem) {
  const { unit, bound, observed } = problem;
  const side = problem.sense === "max" ? "<=" : ">=";
  const { required } = problem.charts;
  const sentences = [];
  if (problem.requirement !== null) sentences.push("Each dot is the value of this requirement in one test; its bounds after each test are not recorded, only the last one.");
  else sentences.push(`Each point of the thick line is what the method could claim if the campaign ended with that test.`);
  if (bound !== null && problem.stopped_by !== "refuted") {
    sentences.push(`The ${problem.stopped_by === null ? "current" : "final"} bound is ${SIGN[side]} ${boundText(bound, side, unit)}${comparedBound(report, problem, side)}.`);
  }
  const instead = claimedInstead(problem);
  if (instead) sentences.push(instead);
  if (problem.drawn && problem.stopped_by === "budget") sentences.push("The last step is there because a number of samples that was fixed beforehand allows a stronger bound than one that may end at any time.");
  if (problem.stopped_by !== null) sentences.push(`It stopped after ${plural(observed, "test")}: ${stoppedText(problem)}.`);
  const cut = cutBounds(problem);
  if (cut !== null) sentences.push(cut);
  return sentences.join(" ");
}

/** How a bound compares with what is required, unless the data say otherwise. */
function comparedBound(report, problem, side) {
  const { bound, unit, charts: { required } } = problem;
  if (problem.refuted) return ", and REFUTED by the data: do not rely on it";
  if (required === null) return "";
  const limit = `the requirement of ${SIGN[side]} ${quantity(required, unit)}`;
  const meets = problem.sense === "max" ? bound <= required : bound >= required;
  if (!meets) return `, and does not meet ${limit}`;
  return report.verdict?.word === "VIOLATED" ? `, beyond ${limit}; but the verdict is VIOLATED` : `, and meets ${limit}`;
}

/** Least and greatest value of the chart of the bounds: early bounds that say little must not flatten all others. */
function boundRange(problem) {
  return once(problem, "bound range", () => rangeOfBounds(problem));
}

function rangeOfBounds(problem) {
  const { required, clip, of_robustness: ofRobustness } = problem.charts;
  // What is weaker than the clip alone needs no room.
  const [lower, upper] = [problem.tests.lower, problem.tests.upper].map((values) => values.map((value) => clippedTo(clip, value)));
  const last = [lower.findLast((value) => value !== null), upper.findLast((value) => value !== null)];
  const sorted = observedBesideBounds(problem).filter((value) => value !== null).sort((a, b) => (problem.sense === "max" ? b - a : a - b));
  const worst = sorted.slice(0, Math.max(1, Math.ceil(HARMLESS * sorted.length)));
  const core = extent(worst, last, [problem.bound, required, ofRobustness || valueName(problem) === "probability" ? 0 : null]) ?? [0, 1];
  const span = core[1] - core[0] || Math.abs(core[0]) || 1;
  const near = clip.filter((value) => value !== null && value > core[0] - NEAR_CLIP * span && value < core[1] + NEAR_CLIP * span);
  const all = extent(core, sorted, lower, upper, near) ?? core;
  const late = extent(core, ...[lower, upper].map((values) => values.slice(Math.floor(values.length / 4))));
  const reach = (early, later) => Math.max(Math.min(early, MOST_CUT * span), Math.min(later, MOST_LATE * span));
  const [low, high] = [core[0] - reach(core[0] - all[0], core[0] - late[0]), core[1] + reach(all[1] - core[1], late[1] - core[1])];
  const margin = 0.04 * (high - low) || 0.5;
  return [low - margin, high + margin];
}

/** A value within the ends of the clip, which may be missing. */
function clippedTo([low, high], value) {
  if (value === null) return null;
  return Math.min(Math.max(value, low ?? -Infinity), high ?? Infinity);
}

/** What the last bound of the method says where it is not the bound that is claimed; empty where it is. */
function claimedInstead(problem) {
  const values = problem.tests[claimedSide(problem)];
  const last = values.findLast((value) => value !== null);
  if (last === undefined || problem.bound === null || problem.requirement !== null) return "";
  const weaker = problem.sense === "max" ? last - problem.bound : problem.bound - last;
  if (weaker <= 1e-6 * (1 + Math.abs(problem.bound))) return "";
  const [side, unit] = [problem.sense === "max" ? "<=" : ">=", problem.unit];
  return `The method itself shows no more than ${SIGN[side]} ${boundText(last, side, unit)} after the last test, which is weaker than what the clip alone proves.`;
}

/** A sentence on the bounds and the values that are outside of the picture; null if none is. */
function cutBounds(problem) {
  const [low, high] = boundRange(problem);
  const { lower, upper, test } = problem.tests;
  const parts = [];
  for (const [name, values, outside] of [["lower", lower, (value) => value < low], ["upper", upper, (value) => value > high]]) {
    const rows = values.map((_, k) => k).filter((k) => values[k] !== null && outside(values[k]));
    if (!rows.length) continue;
    const far = extent(rows.map((k) => values[k]))[name === "lower" ? 0 : 1];
    const which = rows.length === 1 ? `bound of test ${count(test[rows[0]])}` : `bounds of tests ${count(test[rows[0]])} to ${count(test[rows.at(-1)])}`;
    parts.push(`the ${name} ${which}, as far as ${quantity(far, problem.unit)}`);
  }
  const observed = observedBesideBounds(problem).filter((value) => value !== null && (value < low || value > high));
  if (observed.length) parts.push(`${plural(observed.length, "observed value")}, as far as ${quantity(extent(observed)[problem.sense === "max" ? 0 : 1], problem.unit)}`);
  return parts.length ? `Outside of the picture: ${parts.join(", and ")}.` : null;
}

/** The lines across the chart of the bounds: the requirement, the clip, and the last bound. */
function boundLevels(problem) {
  const { required, clip, of_robustness: ofRobustness } = problem.charts;
  const side = problem.sense === "max" ? "<=" : ">=";
  const levels = clip.filter((value) => value !== null).map((value) => ({ value, label: `clip ${num(value)}`, colour: "muted", dash: [2, 4] }));
  if (required !== null) levels.push({ value: required, label: `required ${num(required)}`, colour: "red", dash: [7, 4], wide: true });
  if (ofRobustness && required !== 0) levels.push({ value: 0, label: "violated below 0", colour: "red", dash: [2, 3] });
  if (problem.bound !== null) levels.push({ value: problem.bound, label: `${problem.refuted || problem.stopped_by === "refuted" ? "refuted" : "bound"} ${outward(problem.bound, side)}`, colour: "blue" });
  return levels;
}

function drawBounds(problem, index) {
  const { test, lower, upper } = problem.tests;
  const { unit } = problem;
  const observed = observedBesideBounds(problem);
  const violates = (value) => problem.charts.of_robustness && value !== null && value < 0;
  const names = boundNames(problem);
  const look = (side) => (side === claimedSide(problem) ? { colour: "blue", width: 2.2 } : { colour: "ink", width: 1, dash: [5, 3] });
  const series = [
    [{ label: "observed", colour: "muted", points: true, size: 4, unit }, observed.map((value) => (violates(value) ? null : value))],
    [{ label: "observed", colour: "red", points: true, size: 5, unit }, observed.map((value) => (violates(value) ? value : null))],
    [{ label: names.lower, ...look("lower"), unit, sense: ">=" }, lower],
    [{ label: names.upper, ...look("upper"), unit, sense: "<=" }, upper],
  ].filter(([, values]) => values.some((value) => value !== null));
  const stop = problem.stopped_by === null || !test.length ? null : { at: test.at(-1), label: stopLabel(problem) };
  chart(
    document.getElementById(`bound-${index}`),
    { height: CHART.height, x: "test", y: { label: withUnit(valueName(problem), unit) }, series: series.map(([each]) => each), legend: false },
    [test, ...series.map(([, values]) => values)],
    (plot) => readBounds(plot, problem, index),
    { range: boundRange(problem), levels: boundLevels(problem), stop },
  );
}

const STOP_WORDS = { converged: "alpha reached", budget: "budget used up", counterexample: "counterexample", refuted: "refuted" };

function stopLabel(problem) {
  const planned = problem.alpha === null && problem.stopped_by === "budget"; // a fixed number of tests
  return planned ? stoppedText(problem) : `stopped: ${STOP_WORDS[problem.stopped_by] ?? short(problem.stopped_by, 30)}`;
}

/** What a value of the objective is, as a name of an axis. */
function valueName(problem) {
  if (drawsStarts(problem) && problem.sense === "max") return "probability";
  return problem.charts.of_robustness ? "robustness" : "value";
}

/** Write the values of the test at the pointer. */
function readBounds(plot, problem, index) {
  const { test, y, lower, upper } = problem.tests;
  const k = plot.cursor.idx;
  if (k === null || k === undefined) return;
  const parts = [
    [y[k], `observed ${quantity(y[k], observedUnit(problem))}`],
    [lower[k], `lower bound ${boundText(lower[k], ">=", problem.unit)}`],
    [upper[k], `upper bound ${boundText(upper[k], "<=", problem.unit)}`],
  ];
  const text = parts.filter(([value]) => value !== null && value !== undefined).map(([, each]) => each).join(", ");
  document.getElementById(`read-bound-${index}`).textContent = `Test ${count(test[k])}: ${text}.`;
}

function decayFigure(problem, index) {
  if (!converges(problem)) return null;
  const now = problem.tests.distance.findLast((value) => value !== null);
  const name = sentence(problem.distance, 20);
  const meaning = problem.distance === "U - L" ? "the distance between the two bounds" : "what the next test may still be worse than the last bound";
  const end = now === undefined ? "" : ` After the last test it is ${quantity(now, problem.unit)}.`;
  return chartFigure(
    `decay-${index}`,
    `Convergence: ${name} after each test`,
    caption(`${name} is ${meaning}; the problem stops when it reaches the dashed line, the tolerance alpha.${end}`),
  );
}

function drawDecay(problem, index) {
  const { test, distance } = problem.tests;
  const { unit, alpha } = problem;
  const positive = extent(distance.filter((value) => value > 0), [alpha]);
  const log = alpha > 0 && positive[1] > 20 * positive[0];
  const label = sentence(problem.distance, 20);
  chart(
    document.getElementById(`decay-${index}`),
    {
      height: CHART.decay, x: "test", y: { label: withUnit(label, unit), log }, legend: false,
      series: [{ label, colour: "blue", unit, width: 2 }, { label: "alpha", colour: "red", width: 0, unit }],
    },
    [test, distance.map((value) => (log && value <= 0 ? null : value)), test.map(() => alpha)],
    undefined,
    { levels: [{ value: alpha, label: `alpha ${num(alpha)}`, colour: "red", dash: [7, 4] }] },
  );
}

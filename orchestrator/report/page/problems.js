"use strict";
// One problem: its numbers, its map with the bars of its starts, how its bound came down, its worst tests.

const SERIES = ["mean", "lower", "upper"];
const STOPPED = {
  converged: "converged: what is left is at most alpha",
  budget: "its budget ended, NOT converged",
  refuted: "REFUTED: the data contradict the assumptions",
};
const MOST_BARS = 60;
const MOST_WORST = 8;

/** The section of the problem with this index; `shown` is the series of its map. */
function problemSection(story, index, shown, selected) {
  const problem = story.problems[index];
  const kind = mapKind(story, problem);
  const bars = problem.surface?.shape === null ? startBars(story, index, kind === null) : null;
  return el(
    `section.problem#problem-${index}`,
    { "data-problem": problem.name },
    el("h2", {}, named(words(problem.name)), el("span.muted", {}, ` ${short(problem.objective, 200)}; method ${words(problem.method)}`)),
    numbers(problem),
    el(
      "div.columns",
      {},
      el("div", {}, kind === null ? null : mapFigure(story, index, kind, shown), bars),
      el("div", {}, decayFigure(problem, index), boundFigure(problem, index), worstTests(story, problem, selected)),
    ),
  );
}

/** The line of numbers. */
function numbers(problem) {
  const sense = problem.sense === "max" ? "<=" : ">=";
  const facts = [
    ["Bound", problem.bound === null ? "none yet" : `${sense} ${outward(problem.bound, sense)} ${unitText(problem.unit)}`],
    [problem.method === "scenario" ? "The bound tends to" : "Other side", problem.partner === null ? null : `${sense === ">=" ? "<=" : ">="} ${outward(problem.partner, sense === ">=" ? "<=" : ">=")} ${unitText(problem.unit)}`],
    ["Probability", problem.probability === null ? null : `>= ${outward(problem.probability, ">=")}`],
    ["Tests", `${count(problem.tests.test.length)} of at most ${count(problem.budget)}`],
    ["Rollouts", count(problem.rollouts)],
    ["alpha", quantity(problem.alpha, problem.unit)],
    ["delta", num(problem.delta)],
    ["Stopped", problem.stopped_by === null ? null : STOPPED[problem.stopped_by] ?? short(problem.stopped_by)],
    ["Left, as forecast", problem.left === null ? null : short(problem.left, 200)],
  ];
  const bad = problem.stopped_by === "refuted" ? "refuted" : null;
  return el("dl.facts", { "data-stopped": bad }, facts.filter(([, value]) => value !== null).map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
}

function mapFigure(story, index, kind, shown) {
  const problem = story.problems[index];
  const what = { lattice: "Map of the starting conditions", starts: "Map of the starts", profile: "Objective over the starting conditions" }[kind];
  const id = `map-${index}`;
  return el(
    "figure.map",
    {},
    el("figcaption", {}, what, kind === "profile" ? null : seriesSwitch(problem, shown)),
    el(`canvas#${id}`, { "data-keep": id, "data-index": index, tabindex: 0, role: "img", "aria-describedby": `read-${index}`, "aria-label": `${what} of ${words(problem.name)}. Arrow keys go from test to test, Enter shows one.` }),
    el(`p.readout#read-${index}`, { "data-keep": `read-${index}` }, "Point at the map to read it; click a test to see its curves."),
    mapLegend(story, problem, kind),
    problem.surface?.band ? el("p.muted", {}, `Lower and upper: ${short(problem.surface.band, 400)}.`) : null,
  );
}

function seriesSwitch(problem, shown) {
  const have = (name) => problem.surface?.[name].some((value) => value !== null);
  const button = (name) => el("button", { type: "button", "data-series": name, "data-problem": problem.name, disabled: !have(name), "aria-pressed": String(name === shown) }, name);
  return el("span.switch", { role: "group", "aria-label": "Colour shows" }, SERIES.map(button));
}

function mapLegend(story, problem, kind) {
  const mark = (name, text) => el("li", {}, el(`span.mark.${name}`), text);
  const worst = problem.surface?.worst ?? [];
  const region = { lattice: "the worst start may be here", starts: "may be the worst start", profile: "the worst start may be here" }[kind];
  const some = worst.some(Boolean) && !(kind !== "starts" && worst.every(Boolean));
  return el(
    "ul.legend",
    {},
    mark("dot", "test, larger where repeated"),
    mark("first", "first"),
    mark("last", "last"),
    mark("worst", "worst observed"),
    mark("ring", "shown below"),
    some ? mark(`region-${kind}`, region) : null,
    kind === "profile" ? mark("band", "mean and band") : null,
    worst.length && worst.every(Boolean) && kind !== "starts" ? el("li", {}, "the band rules out no start yet") : null,
    story.axes.length > 2 ? el("li", {}, "worst value over the other parameters") : null,
  );
}

/** Starts as intervals, the worst bound first; each one is a button. `only`: there is no map beside it. */
function startBars(story, index, only) {
  const problem = story.problems[index];
  const { points, lower, upper, mean } = problem.surface;
  const up = problem.sense === "max";
  const side = up ? upper : lower;
  const order = points.map((x, n) => n).filter((n) => side[n] !== null).sort((a, b) => (up ? side[b] - side[a] : side[a] - side[b]));
  const range = extent(lower, upper, mean, [problem.bound]) ?? [0, 1];
  const marks = problem.bound === null ? [] : [[problem.bound, `bound ${outward(problem.bound, up ? "<=" : ">=")}`, "bound"]];
  if (range[0] < 0 && range[1] > 0) marks.push([0, "0", "zero"]);
  const dots = new Map(dotsOf(story, problem).map((dot) => [dot.x.join(), dot]));
  const rows = order.slice(0, MOST_BARS).map((n) => startRow(story, problem, n, dots.get(points[n].join()), range, marks));
  const key = (name, text) => el("li", {}, el(`span.key.${name}`), text);
  return el(
    "figure.starts",
    only ? { id: `map-${index}`, "data-tests": problem.tests.test.length, "data-problem": problem.name } : {},
    el("figcaption", {}, `Starts (${story.axes.map((axis) => withUnit(axis.name, axis.unit)).join(", ")}), the worst bound first`),
    el(`div.bars#bars-${index}`, {}, rows),
    order.length > MOST_BARS ? el("p.muted", {}, `${order.length - MOST_BARS} starts with better bounds are not shown.`) : null,
    barScale(range, marks),
    el("ul.legend", {}, key("open", "may be the worst start"), key("interval", "is not the worst start"), key("mean", "mean, where a bar without an upper bound ends")),
    only && problem.surface.band ? el("p.muted", {}, `Lower and upper: ${short(problem.surface.band, 400)}.`) : null,
  );
}

/** One start: from its lower to its upper bound, or to its mean where the other bound is not known. */
function startRow(story, problem, n, dot, range, marks) {
  const { points, lower, upper, mean, worst } = problem.surface;
  const [from, to] = [lower[n] ?? mean[n] ?? upper[n], upper[n] ?? mean[n] ?? lower[n]];
  const bars = [[from, to, worst[n] ? "interval open" : "interval"]];
  if (mean[n] !== null) bars.push([mean[n], mean[n], "mean"]);
  const ends = [lower[n] === null ? null : outward(lower[n], ">="), upper[n] === null ? null : outward(upper[n], "<=")];
  const test = dot ? `${problem.name}:${problem.tests.test[dot.rows[0]]}` : null;
  const title = `${place(points[n], story.axes)}: ${plural(dot?.rows.length ?? 0, "test")}`;
  return el(
    "button.row",
    { type: "button", "data-select": test, disabled: test === null, title },
    barRow(startName(points[n]), bars, ends.filter(Boolean).join(" to "), range, marks),
  );
}

function startName(x) {
  return `(${x.map((value) => num(value)).join(", ")})`;
}

function decayFigure(problem, index) {
  const what = problem.distance === "F_i" ? "F_i goes down to alpha" : `${short(problem.distance, 20)} goes down to alpha`;
  return el("figure", {}, el("figcaption", {}, what), chartHost(`decay-${index}`, `${what} against the number of the test`));
}

function boundFigure(problem, index) {
  return el("figure", {}, el("figcaption", {}, "Bound after every test"), chartHost(`bound-${index}`, "Bounds and observations against the number of the test"));
}

/** The worst test of each of the worst starts, as buttons: also for those who cannot point at a map. */
function worstTests(story, problem, selected) {
  const { test, y } = problem.tests;
  const rank = new Map(worstFirst(story, problem).map((k, place) => [k, place]));
  const dots = dotsOf(story, problem).filter((dot) => rank.has(dot.rows[0]));
  dots.sort((a, b) => rank.get(a.rows[0]) - rank.get(b.rows[0]));
  const item = ({ x, rows }) => {
    const id = `${problem.name}:${test[rows[0]]}`;
    const current = selected?.problem === problem.name && rows.some((k) => test[k] === selected.test);
    const more = rows.length > 1 ? `; ${rows.length} tests here` : "";
    return el(
      "li",
      {},
      el(
        "button",
        { type: "button", "data-test": id, "data-select": id, "aria-current": current ? "true" : null },
        el("b", {}, quantity(y[rows[0]], problem.unit)), el("span", {}, `test ${test[rows[0]]}`), el("span.muted", {}, place(x, story.axes) + more),
      ),
    );
  };
  const list = dots.slice(0, MOST_WORST).map(item);
  return el("div.worst", {}, el("h3", {}, "Worst tests, one of each start"), list.length ? el("ol", {}, list) : el("p.muted", {}, "No test has been observed yet."));
}

/** Draw the charts of a problem into their elements. */
function drawProblemCharts(problem, index) {
  const { test, distance, lower, upper, y } = problem.tests;
  const { unit } = problem;
  const positive = extent(distance.filter((value) => value > 0), [problem.alpha]);
  const log = problem.alpha > 0 && positive[1] > 20 * positive[0];
  const x = { label: "test", name: "test" };
  chart(
    document.getElementById(`decay-${index}`),
    {
      height: 190, x, y: { label: withUnit(problem.distance, unit), log },
      series: [{ label: short(problem.distance, 20), colour: "blue", unit }, { label: "alpha", colour: "red", dash: [6, 4], unit }],
    },
    [test, distance.map((value) => (log && value <= 0 ? null : value)), test.map(() => problem.alpha)],
  );
  const bounds = [
    [{ label: "observed", colour: "muted", points: true, unit }, y],
    [{ label: "lower bound", colour: "blue", unit }, lower],
    [{ label: problem.method === "scenario" ? "what it tends to" : "upper bound", colour: "red", unit }, upper],
  ].filter(([, values]) => values.some((value) => value !== null));
  chart(
    document.getElementById(`bound-${index}`),
    { height: 190, x, y: { label: withUnit("bound", unit) }, series: bounds.map(([series]) => series) },
    [test, ...bounds.map(([, values]) => values)],
  );
}

// Section of one problem: key numbers, map and bars of the starts, convergence, worst tests.

const SERIES = ["mean", "lower", "upper"];
const SERIES_WORDS = { mean: "mean", lower: "lower bound", upper: "upper bound" };
const STOPPED = {
  converged: "stop threshold alpha reached",
  budget: "budget used up, alpha NOT reached",
  counterexample: "a rollout violated the specification, which ends this campaign",
  refuted: "REFUTED: the data contradict the assumptions",
};
const MOST_BARS = 60;
const MOST_WORST = 8;

/** The section of the problem with this index; `shown` are series and axes of its map. */
function problemSection(report, index, shown, selected) {
  const problem = report.problems[index];
  const kind = mapKind(report, problem);
  const wide = report.axes.length > 2 || problem.charts.prediction === null; // room to the right, none to the left
  const importances = [importanceFigure(report, problem), disturbanceFigure(report, problem)];
  const bars = isListed(problem) ? startBars(report, index, kind === null) : null;
  return el(
    `section.problem#problem-${index}`,
    { "data-problem": problem.name },
    el("h2", nameElement(words(problem.name) + (problem.requirement === null ? "" : `: ${problem.requirement}`)), el("span.muted", ` ${sentence(problem.objective, 200)}; method ${words(problem.method)}`)),
    problemFacts(problem),
    problem.observed > problem.tests.test.length ? el("p.muted", `Pictures and lists have ${count(problem.tests.test.length)} of the tests: the worst ones, and an even choice of the others.`) : null,
    problem.warnings.length ? el("ul.warnings", problem.warnings.map((line) => el("li", sentence(line)))) : null,
    el(
      "div.columns",
      el("div", problem.drawn ? histogramFigure(problem.drawn, `histogram-${index}`) : null, requirementTable(problem), boundedRequirements(report, problem), parallelFigure(report, index), kind === null ? null : mapFigure(report, index, kind, shown), bars, predictionFigure(problem, index), ...(wide ? [disturbedFigure(report, problem, index)] : importances)),
      el(
        "div",
        boundFigure(report, problem, index),
        decayFigure(problem, index),
        wide ? importances : null,
        wide ? null : disturbedFigure(report, problem, index),
        rolloutFigure(problem, index),
        worstTests(report, problem, selected),
      ),
    ),
  );
}

/** One row for each requirement that is bounded on its own: what is bounded, and its worst test as a button. */
function boundedRequirements(report, problem) {
  const parts = report.problems.filter((each) => each.name === problem.name && each.requirement !== null);
  if (!parts.length || problem.requirement !== null) return null;
  const row = (each) => {
    const worst = worstFirst(report, each)[0];
    const id = worst === undefined ? null : `${each.name}:${each.tests.test[worst]}`;
    return el(
      "tr",
      el("th", { scope: "row" }, nameElement(each.requirement, 40)),
      el("td", each.bound === null ? null : refutedBound(each, `${SIGN[">="]} ${boundText(each.bound, ">=", each.unit)}`)),
      el("td", each.partner === null ? null : `${SIGN["<="]} ${boundText(each.partner, "<=", each.unit)}`),
      el("td", each.stopped_by === null ? "open" : STOPPED[each.stopped_by] ?? short(each.stopped_by)),
      el("td", id === null ? null : el("button", { "data-test": id, "data-select": id }, quantity(each.tests.y[worst], each.unit))),
    );
  };
  const heads = ["Requirement", "Bound", "Opposite bound", "State", "Worst test"];
  return el(
    "figure.requirements",
    el("figcaption", "Requirements, each with its own claim"),
    el("table", el("thead", el("tr", heads.map((head) => el("th", { scope: "col" }, head)))), el("tbody", parts.map(row))),
  );
}

/** A bound in words, with the mark of a refuted one. */
function refutedBound(problem, text) {
  return problem.refuted && text !== null ? [el("s", text), " ", el("strong.bad", "REFUTED")] : text;
}

/** The key numbers of a problem. */
function problemFacts(problem) {
  const [sense, opposite] = problem.sense === "max" ? ["<=", ">="] : [">=", "<="];
  const bounded = (value, side, unit) => (value === null ? null : sentence(`${side} ${boundText(value, side, unit)}`));
  const facts = [
    ["Bound", refutedBound(problem, bounded(problem.bound, sense, problem.unit)) ?? "none yet"],
    [problem.method === "scenario" ? "Limit of the bound" : "Opposite bound", bounded(problem.partner, opposite, problem.unit)],
    ["Probability", problem.refuted ? "none: an assumption is refuted" : problem.probability === 1 ? "certain, if its assumptions hold" : bounded(problem.probability, ">=", "")],
    ["Tests", `${count(problem.observed)} of at most ${count(problem.budget)}`],
    ["Rollouts", count(problem.rollouts)],
    ["Samples that violate the specification", problem.drawn ? `${count(problem.drawn.violations)} of ${count(samplesOf(problem))}` : null],
    ["Robustness exactly 0, counted as violations", problem.drawn?.zeros ? count(problem.drawn.zeros) : null],
    ["Stop threshold alpha", problem.alpha === null ? null : quantity(problem.alpha, problem.unit)],
    ["Failure probability delta", num(problem.delta)],
    ["Stopped", problem.stopped_by === null ? null : stoppedText(problem)],
    [problem.drawn ? "Left" : "Tests left (forecast)", problem.left === null ? null : short(problem.left, 200)],
    ["Outlook", problem.outlook === null ? null : short(problem.outlook, 200)],
  ];
  return definitions(".facts", facts, { "data-stopped": problem.stopped_by });
}

function stoppedText(problem) {
  if (problem.alpha === null && problem.stopped_by === "budget") return problem.drawn ? "all samples were drawn" : "all tests were made";
  return STOPPED[problem.stopped_by] ?? short(problem.stopped_by);
}

function mapFigure(report, index, kind, { series, chosen }) {
  const problem = report.problems[index];
  const band = bandOver(problem, chosen);
  const title = { lattice: "Map of the starting conditions", starts: "Map of the starts", profile: "Objective over the starting conditions" }[kind];
  const id = `map-${index}`;
  return el(
    "figure.map",
    el("figcaption", title, report.axes.length > 2 ? axisSwitch(report, problem, chosen) : null, kind === "profile" || band === null ? null : seriesSwitch(problem, band, series)),
    el(`canvas#${id}`, { "data-keep": true, "data-index": index, tabindex: 0, role: "img", "aria-describedby": `read-${index}`, "aria-label": `${title} of ${words(problem.name)}. Arrow keys move between tests, Enter selects one.` }),
    el(`p.readout#read-${index}`, { "data-keep": true }, "Point at the map to read values; select a test to plot its rollouts."),
    mapLegend(report, problem, kind, band, chosen),
    caption(mapCaption(report, problem, kind, band, { series, chosen })),
  );
}

/** What a map shows, and how to read it. */
function mapCaption(report, problem, kind, band, { series, chosen }) {
  if (band === null) return "Each dot is a tested start; the stronger its colour the worse its observed value, with half of the tests on either side of the middle.";
  const name = valueName(problem);
  const worse = problem.sense === "max" ? "greater" : "smaller";
  const of = { mean: `the mean of the model of the ${name}`, lower: `the lower bound on the ${name}`, upper: `the upper bound on the ${name}` }[series];
  const shown = {
    lattice: `Each cell is a start, and its colour ${of}: dark is ${worse}, so worse. White dots are tested starts.`,
    starts: `Each disc is a start, and its colour ${of}: dark is ${worse}, so worse.`,
    profile: `The curve is the mean of the model of the ${name}, the band what the method allows; dots are tests.`,
  }[kind];
  const plane = band.shape && report.axes.length > 2 ? ` ${planeText(report, band, chosen)}` : "";
  return [shown + plane, requirementText(problem, kind === "profile" ? null : extent(band[series])), failingText(problem), overshootText(problem, series, kind), bandText(problem, band)].filter(Boolean).join(" ");
}

/** The value that a problem is compared with: what is required, or for a robustness the border of the specification. */
function comparedWith({ charts: { required, of_robustness: ofRobustness } }) {
  if (required !== null) return [required, "the required"];
  return ofRobustness ? [0, "the border of the specification,"] : null;
}

/** Where the colours of a map are relative to the requirement. */
function requirementText(problem, range) {
  const limit = comparedWith(problem);
  if (limit === null || range === null) return "";
  const [value, name] = limit;
  const text = `${name} ${quantity(value, problem.unit)}`;
  const but = problem.refuted ? ", but these are numbers of a refuted model" : "";
  if (value < range[0]) return `All colours are above ${text}${but}.`;
  if (value > range[1]) return `All colours are below ${text}${but}.`;
  return `The line across the colour bar is ${text}${but}.`;
}

/** What the crosses of a map are; empty where there are none. */
function failingText(problem) {
  const { failing } = problem.charts;
  if (!failing.length) return "";
  const violating = failing.filter((each) => each.violations).length;
  const contradicting = failing.filter((each) => each.contradicts).length;
  const parts = [violating ? `at ${plural(violating, "fresh start")} of the spot check rollouts violate the specification` : null, contradicting ? `at ${plural(contradicting, "fresh start")} the bound is refuted` : null];
  const text = parts.filter(Boolean).join(", and ");
  return `The crosses are no tests of this problem: ${text}.`;
}

/** Where the model goes beyond what a rollout can be. */
function overshootText({ charts: { overshoots, clip }, unit }, series, kind) {
  if (!(overshoots > 0) || (series !== "mean" && kind !== "profile")) return "";
  const ends = clip.filter((value) => value !== null).map((value) => quantity(value, unit)).join(" to ");
  return `At ${percent(overshoots)} of the starts the model goes beyond the clip (${ends}), as no rollout can; its mean is cut there.`;
}

function bandText(problem, band) {
  return band?.band ? `Lower and upper bounds ${problem.refuted ? "would be" : "are"} ${sentence(band.band, 400)}${problem.refuted ? ", which the data refute" : ""}.` : "";
}

/** Where a plane is in the other parameters. */
function planeText(report, band, chosen) {
  const others = report.axes.map((_, k) => k).filter((k) => !chosen.includes(k));
  return `The plane through the worst start observed: ${place(others.map((k) => band.through[k]), axesOf(report, others))}. Tests beside it are faint.`;
}

/** The choice of the two axes of a map. */
function axisSwitch(report, problem, chosen) {
  const option = (axis, k, at) => el("option", { value: k, selected: k === chosen[at] }, shortMiddle(axis.name, 20) + unitOf(axis));
  const choice = (name, at) =>
    el("select", { "data-axis": at, "data-problem": problem.name, "aria-label": name, title: name }, [...new Set([...readAxes(report), ...chosen])].map((k) => option(report.axes[k], k, at)));
  return el("span.axes", choice("Horizontal axis", 0), "\u00d7", choice("Vertical axis", 1));
}

function seriesSwitch(problem, band, series) {
  const hasValues = (name) => band[name].some((value) => value !== null);
  const button = (name) => el("button", { "data-series": name, "data-problem": problem.name, disabled: !hasValues(name), "aria-pressed": String(name === series) }, SERIES_WORDS[name]);
  return el("span.switch", { role: "group", "aria-label": "Values on the map" }, SERIES.map(button));
}

function mapLegend(report, problem, kind, band, chosen) {
  const worst = band?.worst ?? [];
  const excludesNone = worst.length > 0 && worst.every(Boolean) && kind !== "starts";
  const model = problem.refuted ? "by the refuted model " : "";
  const meaning = { lattice: `${model}the worst start may be on the side of the ticks`, starts: `thick edge: ${model}possible worst start`, profile: `${model}possible worst start` }[kind];
  return el(
    "ul.legend",
    ownDots(kind, band) ? legendItem("mark.dot", "listed start, larger where tested more often") : sizeLegend(dotsOf(report, problem, chosen)),
    band ? null : observedLegend(report, problem),
    violating(report, problem).size ? legendItem("mark.violates", "violates the specification") : null,
    problem.charts.failing.length ? legendItem("mark.failing", "fresh start of the spot check that fails") : null,
    legendItem(freshIsWorst(report, problem) ? "mark.failing.worst-fresh" : "mark.worst", "worst observed"),
    legendItem("mark.ring", "selected test"),
    worst.some(Boolean) && !excludesNone ? (kind === "lattice" ? el("li", el("span.mark.outline", tickedLine()), meaning) : legendItem(`mark.region-${kind}`, meaning)) : null,
    kind === "profile" ? legendItem("mark.band", "mean and band") : null,
    excludesNone ? el("li", `every start ${report.axes.length > 2 ? "of this plane " : ""}is a possible worst start so far`) : null,
  );
}

/** A piece of the line around the possible worst starts. */
function tickedLine() {
  const ticks = [4, 12, 20].map((x) => svg("line", { x1: x, x2: x, y1: 2, y2: 9 }));
  return svg("svg", { width: 24, height: 10, "aria-hidden": "true" }, svg("line", { x1: 0, x2: 24, y1: 2, y2: 2 }), ...ticks);
}

/** The dots of a start with few and with many tests, as large as on the map. */
function sizeLegend(dots) {
  const most = Math.max(1, ...dots.map(({ rows }) => rows.length));
  const sizes = [1, 5, 20, 100, 1000].filter((tests) => tests < most * 0.8);
  const shown = most === 1 ? [1] : [...sizes, most].slice(-3);
  if (shown[0] !== 1) shown[0] = 1;
  const disc = (tests) => {
    const radius = dotRadius(tests, most, dots.length);
    const side = 2 * radius + 3;
    return svg("svg", { width: side, height: side, "aria-hidden": "true" }, svg("circle", { cx: side / 2, cy: side / 2, r: radius }));
  };
  return shown.map((tests) => el("li", el("span.mark.size", disc(tests)), `${plural(tests, "test")}${tests === 1 ? " at a start" : ""}`));
}

/** The colours of the observed values. */
function observedLegend(report, problem) {
  const values = observedValues(report, problem);
  return values && el("li", el("span.ramp"), `observed: ${num(values[0])} (worst), ${num(values[1])} (middle), ${quantity(values[2], observedUnit(problem))} (best)`);
}

/** Starts as intervals, the worst bound first, as buttons; `alone`: without a map. */
function startBars(report, index, alone) {
  const problem = report.problems[index];
  const [band] = problem.surfaces;
  const { points, lower, upper, mean } = band;
  const up = problem.sense === "max";
  const side = up ? upper : lower;
  const order = points.map((x, n) => n).filter((n) => side[n] !== null).sort((a, b) => (up ? side[b] - side[a] : side[a] - side[b]));
  const range = extent(lower, upper, mean, [problem.bound]) ?? [0, 1];
  const marks = problem.bound === null ? [] : [[problem.bound, `bound ${outward(problem.bound, up ? "<=" : ">=")}`, "bound"]];
  const limit = comparedWith(problem);
  if (limit !== null && range[0] <= limit[0] && range[1] >= limit[0]) marks.push([limit[0], `${limit[1].replace(/^the |,$/g, "")} ${num(limit[0])}`, "zero"]);
  const dots = new Map(dotsOf(report, problem).map((dot) => [dot.x.join(), dot]));
  const rows = order.slice(0, MOST_BARS).map((n) => startRow(report, problem, n, dots.get(points[n].join()), range, marks));
  return el(
    "figure.starts",
    alone ? { id: `map-${index}`, "data-tests": problem.tests.test.length, "data-problem": problem.name } : {},
    el("figcaption", `Starts (${[...axesOf(report, readAxes(report)).map((axis) => withUnit(axis.name, axis.unit)), ...longInputs(report.axes)].join(", ")}), worst bound first`),
    el(`div.bars#bars-${index}`, rows),
    order.length > MOST_BARS ? el("p.muted", `${order.length - MOST_BARS} starts with better bounds are not shown.`) : null,
    barScale(range, marks),
    el("ul.legend", legendItem("key.open", "possible worst start"), legendItem("key.interval", "excluded"), legendItem("key.mean", "mean; a bar with one bound only ends here")),
    caption([`Each bar is a start, from its lower to its upper bound; starts of pale bars cannot be the worst any more.`, overshootText(problem, "mean", "profile"), alone ? bandText(problem, band) : ""].filter(Boolean).join(" ")),
  );
}

/** One start: from its lower to its upper bound; without one of them, to its mean. */
function startRow(report, problem, n, dot, range, marks) {
  const { points, lower, upper, mean, worst } = problem.surfaces[0];
  const [from, to] = [lower[n] ?? mean[n] ?? upper[n], upper[n] ?? mean[n] ?? lower[n]];
  const bars = [[from, to, worst[n] ? "interval open" : "interval"]];
  if (mean[n] !== null) bars.push([mean[n], mean[n], "mean"]);
  const ends = [lower[n] === null ? null : outward(lower[n], ">="), upper[n] === null ? null : outward(upper[n], "<=")];
  const test = dot ? `${problem.name}:${problem.tests.test[dot.rows[0]]}` : null;
  const title = `${place(points[n], report.axes)}: ${plural(dot?.rows.length ?? 0, "test")}`;
  return el(
    "button.row",
    { "data-select": test, disabled: test === null, title },
    barRow(`(${points[n].filter((_, k) => !report.axes[k]?.signal).map((value) => num(value)).join(", ")})`, bars, ends.filter(Boolean).join(" to "), range, marks),
  );
}

/** The worst test of each of the worst starts, as buttons: usable without seeing the map. */
function worstTests(report, problem, selected) {
  const { test, y } = problem.tests;
  const rank = new Map(worstFirst(report, problem).map((k, place) => [k, place]));
  const dots = dotsOf(report, problem).filter((dot) => rank.has(dot.rows[0]));
  dots.sort((a, b) => rank.get(a.rows[0]) - rank.get(b.rows[0]));
  const item = ({ x, rows }) => {
    const id = `${problem.name}:${test[rows[0]]}`;
    const current = selected?.problem === problem.name && rows.some((k) => test[k] === selected.test);
    const more = rows.length > 1 ? `; ${count(rows.length)} tests at this start` : "";
    return el(
      "li",
      el(
        "button",
        { "data-test": id, "data-select": id, "aria-current": current ? "true" : null },
        el("b", quantity(y[rows[0]], observedUnit(problem))), el("span", `test ${count(test[rows[0]])}`), el("span.muted.start", { title: place(x, report.axes) }, place(x, report.axes) + more),
      ),
    );
  };
  const sign = problem.sense === "max" && !observesRobustness(problem) ? -1 : 1;
  const tested = dots.slice(0, MOST_WORST).map((dot) => [sign * y[dot.rows[0]], () => item(dot)]);
  const fresh = problem.charts.failing.slice(0, MOST_WORST).map((each) => [sign * each.value, () => freshItem(report, problem, each, selected)]);
  const list = [...fresh, ...tested].sort((a, b) => a[0] - b[0]).slice(0, MOST_WORST).map(([, make]) => make());
  return el("div.worst", el("h3", fresh.length ? "Worst tests and fresh starts, one per start" : "Worst tests, one per start"), list.length ? el("ol", list) : el("p.muted", "No test observed yet."));
}

/** A fresh start that fails, in the list of the worst tests. */
function freshItem(report, problem, { x, series, test, value, rollouts, violations }, selected) {
  const id = `${series}:${test}`;
  const found = violations ? `${count(violations)} of ${plural(rollouts, "rollout")} below 0` : plural(rollouts, "rollout");
  const start = place(x, report.axes);
  return el(
    "li",
    el(
      "button",
      { "data-test": id, "data-select": id, "aria-current": selected?.problem === series && selected.test === test ? "true" : null },
      el("b.bad", quantity(value, observedUnit(problem))), el("span", `${words(series)} ${count(test)}`), el("span.muted.start", { title: start }, `${start}; ${found}`),
    ),
  );
}

/** The unit of what a test observes, which is not that of its bound where that is a probability. */
function observedUnit(problem) {
  return problem.drawn ? problem.drawn.unit : problem.unit;
}

/** Draw the charts of a problem into their elements. */
function drawProblemCharts(report, problem, index) {
  if (problem.drawn) drawHistogram(problem.drawn, `histogram-${index}`);
  if (converges(problem)) drawDecay(problem, index);
  drawBounds(problem, index);
  drawPrediction(problem, index);
  drawDisturbed(report, problem, index);
  drawRolloutHistograms(problem, index);
}

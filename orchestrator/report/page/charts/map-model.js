// Model of a map of D: pure functions from report data to places, colours and text; map-draw.js draws the result.

/** Viridis in ten steps: perceptually even, also in greyscale. */
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
];
const REACH = 14; // pixels around the centre of a dot that select it
const MARGIN = { left: 44, top: 24, bottom: 40, right: 12, bar: 74 }; // pixels; bar: to the right, with a colour bar

/** Whether the starts are drawn, and the claims are about drawn starts. */
function drawsStarts({ method }) {
  return method === "sample";
}

/** Whether a test observes the robustness itself, whatever is bounded: where starts are drawn. */
function observesRobustness(problem) {
  return drawsStarts(problem);
}

const results = new WeakMap(); // problem -> Map of results, which are the same until the next data: a pointer moves often

/** The result of `compute` for a problem, computed once for each name. */
function once(problem, name, compute) {
  if (!results.has(problem)) results.set(problem, new Map());
  const known = results.get(problem);
  if (!known.has(name)) known.set(name, compute());
  return known.get(name);
}

/** Rows of the observed tests, the worst first. */
function worstFirst(report, problem) {
  return once(problem, "worst first", () => sortedRows(report, problem));
}

function sortedRows(report, problem) {
  const sign = problem.sense === "max" && !observesRobustness(problem) ? -1 : 1;
  const withCurves = new Set(report.scenes.filter((each) => each.problem === problem.name).map((each) => each.test));
  const { test, y } = problem.tests;
  return test
    .map((number, row) => row)
    .filter((row) => y[row] !== null)
    // Of equal values the test with curves in the report comes first: the first one is selected.
    .sort((a, b) => sign * (y[a] - y[b]) || withCurves.has(test[b]) - withCurves.has(test[a]) || test[a] - test[b]);
}

/** Whether the worst observed value is that of a fresh start, and of no test. */
function freshIsWorst(report, problem) {
  const [fresh] = problem.charts.failing;
  const [row] = worstFirst(report, problem);
  if (!fresh || row === undefined) return Boolean(fresh);
  const { y } = problem.tests;
  return problem.sense === "max" && !observesRobustness(problem) ? fresh.value > y[row] : fresh.value < y[row];
}

/** The axes of a report that a choice of axes names by their numbers. */
function axesOf(report, chosen) {
  return chosen.map((k) => report.axes[k]);
}

/** The tests of which a rollout violates the specification. */
function violating(report, problem) {
  return once(problem, "violating", () => violatingTests(report, problem));
}

function violatingTests(report, problem) {
  const { test, y } = problem.tests;
  // The report lists the worst violations alone.
  const drawn = observesRobustness(problem) ? test.filter((_, row) => y[row] !== null && y[row] < 0) : [];
  return new Set([...drawn, ...report.counterexamples.filter((each) => each.problem === problem.name).map((each) => each.test)]);
}

/**
 * One dot per place of tested starts on some axes, by default on all: {x, rows}, x on these axes, rows in the columns of
 * the tests, the worst first.
 */
function dotsOf(report, problem, chosen = report.axes.map((_, k) => k)) {
  return once(problem, `dots ${chosen}`, () => groupedTests(report, problem, chosen));
}

function groupedTests(report, problem, chosen) {
  const dots = new Map();
  const rank = new Map(worstFirst(report, problem).map((row, position) => [row, position]));
  problem.tests.x.forEach((start, row) => {
    const x = chosen.map((k) => start[k]);
    const key = x.join();
    if (!dots.has(key)) dots.set(key, { x, rows: [] });
    dots.get(key).rows.push(row);
  });
  const position = (row) => rank.get(row) ?? Infinity; // a test without a value comes last
  for (const dot of dots.values()) dot.rows.sort((a, b) => position(a) - position(b));
  return [...dots.values()];
}

/** The band of a problem over the chosen axes: its listed starts, or the plane of these axes; null without a band. */
function bandOver(problem, chosen) {
  const found = problem.surfaces.find(({ axes, shape }) => shape === null || chosen.every((k) => axes.includes(k)));
  if (!found || found.shape === null || chosen.length < 2 || found.axes[0] === chosen[0]) return found ?? null;
  const [columns, rows] = found.shape;
  const turned = (values) => Array.from(values, (_, n) => values[(n % columns) * rows + Math.floor(n / columns)]);
  const [mean, lower, upper, worst] = [found.mean, found.lower, found.upper, found.worst].map(turned);
  return { ...found, axes: chosen, shape: [rows, columns], mean, lower, upper, worst };
}

/** The start of every node of a band, in its order: last axis fastest. */
function nodesOf(band, axes) {
  if (band === null) return [];
  if (band.shape === null) return band.points;
  const [columns, rows = 1] = band.shape;
  const along = (k, size, step) => axes[k].low + ((axes[k].high - axes[k].low) * step) / Math.max(1, size - 1);
  return Array.from({ length: columns * rows }, (_, n) => {
    const node = [...band.through];
    node[band.axes[0]] = along(band.axes[0], columns, Math.floor(n / rows));
    if (band.axes.length > 1) node[band.axes[1]] = along(band.axes[1], rows, n % rows);
    return node;
  });
}

/** Whether the band of a problem is at listed starts. */
function isListed(problem) {
  return problem.surfaces[0]?.shape === null;
}

/** Kind of map: "lattice", "starts" (dots), "profile" (one parameter), or null where only bars can show the starts. */
function mapKind(report, problem) {
  if (report.axes.length === 1) return isListed(problem) ? null : "profile";
  return isListed(problem) ? "starts" : "lattice";
}

/**
 * Everything that a map of this width draws.
 * @param {{report: object, problem: object, kind: string, chosen: number[], series: string, selected: number|null,
 *   pointer: [number, number]|null, pointed: number|null}} view `chosen` are the numbers of its axes, `pointed` is the
 *   row of the test that the reader points at
 */
function mapModel(view, width) {
  const band = bandOver(view.problem, view.chosen);
  const over = { ...view, band, axes: axesOf(view.report, view.chosen) };
  const at = mapFrame(over, width);
  const nodes = nodesOf(band, view.report.axes);
  const model = {
    ...over, ...at, nodes,
    dots: markedDots({ ...over, nodes }, at),
    failing: failingMarks(over, at),
    scale: colourScale(over),
    region: view.kind === "lattice" && band ? worstRegion(band) : null,
  };
  return { ...model, dotAt: (pixel) => dotNear(model, pixel) };
}

/** Frame of a map. */
function mapFrame({ axes: [first, second], band, problem, kind }, width) {
  const profile = kind === "profile";
  const box = { left: MARGIN.left, top: MARGIN.top, width: Math.max(80, width - MARGIN.left - (band && !profile ? MARGIN.bar : MARGIN.right)) };
  const range = (axis, k) => parameterRange(axis, profile ? 0 : band?.shape?.[k] ?? null);
  const rangeX = range(first, 0);
  const rangeY = profile ? profileRange(band, problem) : range(second, 1);
  // Parameters of one unit have one scale, unless the map became a strip.
  const ratio = !profile && first.unit === second.unit ? (rangeY[1] - rangeY[0]) / (rangeX[1] - rangeX[0]) : 0;
  box.height = box.width * (ratio > 0.4 && ratio < 1.3 ? ratio : 0.7);
  return { ...frame(box, rangeX, rangeY), height: box.top + box.height + MARGIN.bottom };
}

/** Linear map from values to the pixels of a box; y grows upwards. */
function frame(box, rangeX, rangeY) {
  const [spanX, spanY] = [rangeX, rangeY].map(([low, high]) => high - low || 1); // one value alone: avoid 0 / 0
  return {
    box, rangeX, rangeY,
    toX: (value) => box.left + ((value - rangeX[0]) / spanX) * box.width,
    toY: (value) => box.top + box.height - ((value - rangeY[0]) / spanY) * box.height,
  };
}

/** Range of a parameter; a lattice, whose cells are centred on nodes, needs half a cell more. */
function parameterRange({ low, high }, nodes) {
  const margin = nodes === 0 ? 0 : nodes > 1 ? (high - low) / (nodes - 1) / 2 : (high - low) * 0.08 || 0.5;
  return [low - margin, high + margin];
}

/** The values of a profile: of all tests and of the mean, and of the band as far as it does not flatten them. */
function profileRange(band, { tests, charts, bound }) {
  const core = extent(tests.y, band?.mean ?? [], charts.failing.map(({ value }) => value), [bound, charts.required, charts.of_robustness ? 0 : null]) ?? [0, 1];
  const all = extent(core, ...(band ? [band.lower, band.upper] : []));
  const reach = core[1] - core[0] || 1;
  const [low, high] = [Math.max(all[0], core[0] - reach), Math.min(all[1], core[1] + reach)];
  const margin = (high - low) * 0.06 || 0.5;
  return [low - margin, high + margin];
}

/** The values of the chosen series and their colours; null without a value. */
function colourScale({ band, problem, series }) {
  const values = band?.[series] ?? [];
  const range = extent(values);
  if (range === null) return null;
  const [low, high] = range;
  const share = (value) => (high > low ? (value - low) / (high - low) : 0.5);
  // Dark is worse in both senses.
  const colour = (value) => viridis(problem.sense === "max" ? 1 - share(value) : share(value));
  return { low, high, values, colour };
}

/** Colour of a share between 0 and 1 as [r, g, b]. */
function viridis(share) {
  const position = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const k = Math.min(Math.floor(position), VIRIDIS.length - 2);
  return VIRIDIS[k].map((value, c) => Math.round(value + (position - k) * (VIRIDIS[k + 1][c] - value)));
}

/** The edges [i, j, to i, to j, inwards i, inwards j] around the cells that may contain the worst start; null where these are none or all of D. */
function worstRegion({ shape: [columns, rows], worst }) {
  if (worst.every(Boolean) || !worst.some(Boolean)) return null;
  const inside = (i, j) => i >= 0 && j >= 0 && i < columns && j < rows && worst[i * rows + j];
  const edges = [];
  for (let i = 0; i < columns; i += 1) {
    for (let j = 0; j < rows; j += 1) {
      if (!inside(i, j)) continue;
      if (!inside(i - 1, j)) edges.push([i, j, i, j + 1, 1, 0]);
      if (!inside(i + 1, j)) edges.push([i + 1, j, i + 1, j + 1, -1, 0]);
      if (!inside(i, j + 1)) edges.push([i, j + 1, i + 1, j + 1, 0, -1]);
      if (!inside(i, j - 1)) edges.push([i, j, i + 1, j, 0, 1]);
    }
  }
  return edges;
}

const MANY_DOTS = 400;
const LARGEST_DOT = 9; // pixels: radius

/** The dots with their pixels, radii and marks. */
function markedDots(view, { toX, toY, rangeY }) {
  const { y } = view.problem.tests;
  const dots = marked(view, dotsOf(view.report, view.problem, view.chosen));
  const most = Math.max(...dots.map(({ rows }) => rows.length));
  const inPlane = planeTest(view);
  return dots.map((dot) => ({
    ...dot,
    // On a profile a test without a value is drawn at the lower edge.
    at: [toX(dot.x[0]), toY((view.kind === "profile" ? y[dot.rows[0]] : dot.x[1]) ?? rangeY[0])],
    radius: dotRadius(dot.rows.length, most, dots.length),
    off: !dot.rows.some(inPlane),
  }));
}

/** The fresh starts that fail, with their pixels; `off` are those beside the plane of the map. */
function failingMarks(view, { toX, toY }) {
  const { problem, report, kind, chosen, band } = view;
  const fresh = freshIsWorst(report, problem);
  const inPlane = planeTest({ report, problem: { tests: { x: problem.charts.failing.map(({ x }) => x) } }, band, chosen });
  return problem.charts.failing.map((each, k) => ({
    ...each,
    at: [toX(each.x[chosen[0]]), toY(kind === "profile" ? each.value : each.x[chosen[1]])],
    worst: fresh && k === 0,
    off: !inPlane(k),
  }));
}

/** The radius of a dot of so many tests, where `most` have been made at one of `dots` starts. */
function dotRadius(tests, most, dots) {
  const least = dots > MANY_DOTS ? 2 : 3; // many starts would cover one another
  return least + Math.min(1.1, (LARGEST_DOT - least) / Math.sqrt(Math.max(1, most - 1))) * Math.sqrt(tests - 1);
}

/** Dots with the marks that maps and lines share, and with the colour of their worst value. */
function marked({ report, problem, selected, pointed }, dots) {
  const { test, y } = problem.tests;
  const [worst] = worstFirst(report, problem);
  const violations = violating(report, problem);
  const colour = observedColour(report, problem);
  const fresh = freshIsWorst(report, problem);
  return dots.map((dot) => ({
    ...dot,
    colour: colour(y[dot.rows[0]]),
    first: dot.rows.includes(0),
    last: dot.rows.includes(test.length - 1),
    worst: !fresh && dot.rows.includes(worst),
    violates: dot.rows.some((row) => violations.has(test[row])),
    selected: dot.rows.some((row) => test[row] === selected),
    pointed: dot.rows.includes(pointed),
  }));
}

/** Whether the test of a row is in the plane of a map, to within half the distance of its nodes; all are without one. */
function planeTest({ report, problem, band, chosen }) {
  if (!band || band.shape === null) return () => true;
  const others = report.axes.map((axis, k) => [axis, k]).filter(([, k]) => !chosen.includes(k));
  const near = ({ low, high }) => (high - low) / Math.max(1, band.shape[0] - 1) / 2 + 1e-9 * (high - low);
  return (row) => others.every(([axis, k]) => Math.abs(problem.tests.x[row][k] - band.through[k]) <= near(axis));
}

/** Worst, middle and best observed value; null where nothing is observed. */
function observedValues(report, problem) {
  const rows = worstFirst(report, problem);
  return rows.length ? [0, Math.floor(rows.length / 2), rows.length - 1].map((k) => problem.tests.y[rows[k]]) : null;
}

/** The colour of an observed value: the stronger the worse, on a light as on a dark page; half of the tests have either half. */
function observedColour(report, problem) {
  return rampColour(observedValues(report, problem) ?? [0, 0, 0]);
}

/** The colour of a value by the worst, the middle and the best one. */
function rampColour([worst, middle, best]) {
  const { weak, strong, muted } = theme();
  const share = (value, from, to) => (to === from ? 1 : Math.min(Math.max((value - from) / (to - from), 0), 1));
  return (value) => (value === null ? muted : mixed(strong, weak, (share(value, worst, middle) + share(value, middle, best)) / 2));
}

/** The colour between two hexadecimal ones, at a share of the way. */
function mixed(from, to, share) {
  const parts = [1, 3, 5].map((k) => [from, to].map((colour) => parseInt(colour.slice(k, k + 2), 16)));
  return `rgb(${parts.map(([a, b]) => Math.round(a + share * (b - a))).join()})`;
}

/** The index of the least distance below `limit`, or -1. */
function nearest(distances, limit = Infinity) {
  let [index, least] = [-1, limit];
  distances.forEach((distance, k) => {
    if (distance < least) [index, least] = [k, distance];
  });
  return index;
}

/** The dot nearest to a pixel, or null if none is within reach. */
function dotNear({ dots }, [x, y]) {
  return dots[nearest(dots.map(({ at }) => Math.hypot(at[0] - x, at[1] - y)), REACH)] ?? null;
}

/** The index of the node nearest to a pixel, or -1 outside of the map. */
function nodeNear({ kind, box, nodes, chosen: [first, second], toX, toY }, [x, y]) {
  if (x < box.left || x > box.left + box.width || y < box.top || y > box.top + box.height) return -1;
  return nearest(nodes.map((node) => Math.hypot(toX(node[first]) - x, kind === "profile" ? 0 : toY(node[second]) - y)));
}

/** The tests that the reader points at, and the values at a pixel of a map, as text; empty where there is nothing. */
function readout(model) {
  const { axes, problem, band, nodes, chosen, pointer } = model;
  const dot = model.dots.find((each) => each.pointed);
  const n = band && pointer ? nodeNear(model, pointer) : -1;
  const lines = [];
  if (dot) lines.push(`${dotText(problem, dot)} at ${place(dot.x, axes)}`);
  if (n >= 0) {
    const values = SERIES.map((name) => [name, band[name][n]]).filter(([, value]) => value !== null);
    const sense = { lower: ">=", upper: "<=" };
    const text = values.map(([name, value]) => `${SERIES_WORDS[name]} ${legendText(value, { sense: sense[name], unit: problem.unit })}`).join(", ");
    lines.push(`${place(chosen.map((k) => nodes[n][k]), axes)}: ${text || "no value yet"}`);
  }
  return lines.join("\n");
}

function dotText(problem, { rows }) {
  const { tests } = problem;
  const worst = `test ${count(tests.test[rows[0]])} observed ${quantity(tests.y[rows[0]], observedUnit(problem))}`;
  return rows.length === 1 ? worst : `${rows.length} tests, the worst: ${worst}`;
}

// Model of a map of D: pure functions from report data to places, colours and text; map-draw.js draws the result.

/** Viridis in ten steps: perceptually even, also in greyscale. */
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
];
const REACH = 14; // pixels around the centre of a dot that select it
const MARGIN = { left: 44, top: 24, bottom: 40, right: 12, bar: 74 }; // pixels; bar: to the right, with a colour bar

/** Rows of the observed tests, the worst first. */
function worstFirst(report, problem) {
  const sign = problem.sense === "max" && !problem.drawn ? -1 : 1;
  const withCurves = new Set(report.scenes.filter((each) => each.problem === problem.name).map((each) => each.test));
  const { test, y } = problem.tests;
  return test
    .map((number, row) => row)
    .filter((row) => y[row] !== null)
    // Of equal values the test with curves in the report comes first: the first one is selected.
    .sort((a, b) => sign * (y[a] - y[b]) || withCurves.has(test[b]) - withCurves.has(test[a]) || test[a] - test[b]);
}

/** One dot per tested start: {x, rows: its rows in the columns of the tests, the worst first}. */
function dotsOf(report, problem) {
  const dots = new Map();
  const rank = new Map(worstFirst(report, problem).map((row, position) => [row, position]));
  problem.tests.x.forEach((x, row) => {
    const key = x.join();
    if (!dots.has(key)) dots.set(key, { x, rows: [] });
    dots.get(key).rows.push(row);
  });
  const position = (row) => rank.get(row) ?? Infinity; // a test without a value comes last
  for (const dot of dots.values()) dot.rows.sort((a, b) => position(a) - position(b));
  return [...dots.values()];
}

/** The first two parameters of every node of a surface, in its order: last axis fastest. */
function nodesOf(surface, axes) {
  if (surface === null) return [];
  if (surface.shape === null) return surface.points;
  const [columns, rows] = surface.shape;
  const node = ({ low, high }, size, step) => low + ((high - low) * step) / Math.max(1, size - 1);
  if (rows === undefined) return Array.from({ length: columns }, (_, i) => [node(axes[0], columns, i)]);
  return Array.from({ length: columns * rows }, (_, n) => [node(axes[0], columns, Math.floor(n / rows)), node(axes[1], rows, n % rows)]);
}

/** Kind of map: "lattice", "starts" (dots), "profile" (one parameter), or null where only bars can show the starts. */
function mapKind(report, problem) {
  const listed = problem.surface !== null && problem.surface.shape === null;
  if (report.axes.length === 1) return listed ? null : "profile";
  if (listed) return report.axes.length === 2 ? "starts" : null;
  return "lattice";
}

/**
 * Everything that a map of this width draws.
 * @param {{report: object, problem: object, kind: string, series: string, selected: number|null, pointer: [number, number]|null}} view
 */
function mapModel(view, width) {
  const { report, problem, kind } = view;
  const at = mapFrame(view, width);
  return {
    ...view, ...at,
    nodes: nodesOf(problem.surface, report.axes),
    dots: markedDots(view, at),
    scale: colourScale(view),
    region: kind === "lattice" && problem.surface ? worstRegion(problem.surface) : null,
  };
}

/** Frame of a map. */
function mapFrame({ report, problem, kind }, width) {
  const [first, second] = report.axes;
  const profile = kind === "profile";
  const box = { left: MARGIN.left, top: MARGIN.top, width: Math.max(80, width - MARGIN.left - (profile ? MARGIN.right : MARGIN.bar)) };
  const range = (axis, k) => parameterRange(axis, profile ? 0 : problem.surface?.shape?.[k] ?? null);
  const rangeX = range(first, 0);
  const rangeY = profile ? profileRange(problem) : range(second, 1);
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

function profileRange({ surface, tests }) {
  const [low, high] = extent(tests.y, ...(surface ? [surface.lower, surface.upper, surface.mean] : [])) ?? [0, 1];
  const margin = (high - low) * 0.06 || 0.5;
  return [low - margin, high + margin];
}

/** The values of the chosen series and their colours; null without a value. */
function colourScale({ problem, series }) {
  const values = problem.surface?.[series] ?? [];
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

/** Cells that may contain the worst start and the edges around them; null where these are none or all of D. */
function worstRegion({ shape: [columns, rows], worst }) {
  if (worst.every(Boolean) || !worst.some(Boolean)) return null;
  const inside = (i, j) => i >= 0 && j >= 0 && i < columns && j < rows && worst[i * rows + j];
  const [cells, edges] = [[], []];
  for (let i = 0; i < columns; i += 1) {
    for (let j = 0; j < rows; j += 1) {
      if (!inside(i, j)) continue;
      cells.push([i, j]);
      if (!inside(i - 1, j)) edges.push([i, j, i, j + 1]);
      if (!inside(i + 1, j)) edges.push([i + 1, j, i + 1, j + 1]);
      if (!inside(i, j + 1)) edges.push([i, j + 1, i + 1, j + 1]);
      if (!inside(i, j - 1)) edges.push([i, j, i + 1, j]);
    }
  }
  return { cells, edges };
}

const MANY_DOTS = 400;

/** The dots with their pixels, radii and marks. */
function markedDots({ report, problem, kind, selected }, { toX, toY, rangeY }) {
  const { test, y } = problem.tests;
  const [worst] = worstFirst(report, problem);
  const dots = dotsOf(report, problem);
  // Many starts would cover one another.
  const least = dots.length > MANY_DOTS ? 1.7 : 3;
  return dots.map(({ x, rows }) => ({
    x, rows,
    // On a profile a test without a value is drawn at the lower edge.
    at: [toX(x[0]), toY((kind === "profile" ? y[rows[0]] : x[1]) ?? rangeY[0])],
    radius: Math.min(least + 1.1 * Math.sqrt(rows.length - 1), 8),
    first: rows.includes(0),
    last: rows.includes(test.length - 1),
    worst: rows.includes(worst),
    // Of drawn starts the observation is the robustness itself.
    violates: problem.drawn ? y[rows[0]] !== null && y[rows[0]] < 0 : false,
    selected: rows.some((row) => test[row] === selected),
  }));
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
function nodeNear({ kind, box, nodes, toX, toY }, [x, y]) {
  if (x < box.left || x > box.left + box.width || y < box.top || y > box.top + box.height) return -1;
  return nearest(nodes.map((node) => Math.hypot(toX(node[0]) - x, kind === "profile" ? 0 : toY(node[1]) - y)));
}

/** The tests and values at a pixel as text; empty where there is nothing. */
function readout(model, pixel) {
  const { report, problem, nodes } = model;
  const [dot, n] = [dotNear(model, pixel), nodeNear(model, pixel)];
  const lines = [];
  if (dot) lines.push(`${place(dot.x, report.axes)}: ${dotText(problem, dot)}`);
  if (n >= 0 && problem.surface) {
    const values = SERIES.map((name) => [name, problem.surface[name][n]]).filter(([, value]) => value !== null);
    const sense = { lower: ">=", upper: "<=" };
    const text = values.map(([name, value]) => `${name} ${legendText(value, { sense: sense[name], unit: problem.unit })}`).join(", ");
    lines.push(`${place(nodes[n], report.axes)}: ${text || "no value yet"}`);
  }
  return lines.join("\n");
}

function dotText(problem, { rows }) {
  const { tests } = problem;
  const worst = `test ${tests.test[rows[0]]} observed ${quantity(tests.y[rows[0]], observedUnit(problem))}`;
  return rows.length === 1 ? worst : `${rows.length} tests, the worst: ${worst}`;
}

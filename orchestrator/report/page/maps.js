"use strict";
// The map of D: what is known of the objective everywhere, the tests, and where the worst start may still be.

const views = new WeakMap(); // canvas -> what is drawn on it
const REACH = 14; // pixels around a dot that belong to it

/** Order of tests, the worst first; of equal ones that whose curves are at hand, then the older one. */
function worstFirst(story, problem) {
  const sign = problem.sense === "max" ? -1 : 1;
  const shown = new Set(story.scenes.filter((each) => each.problem === problem.name).map((each) => each.test));
  const { test, y } = problem.tests;
  return test
    .map((number, k) => k)
    .filter((k) => y[k] !== null)
    .sort((a, b) => sign * (y[a] - y[b]) || shown.has(test[b]) - shown.has(test[a]) || test[a] - test[b]);
}

/** The tests at each place: {x, rows: indices into the columns, the worst first}. */
function dotsOf(story, problem) {
  const dots = new Map();
  const rank = new Map(worstFirst(story, problem).map((k, place) => [k, place]));
  problem.tests.x.forEach((x, k) => {
    const key = x.join();
    if (!dots.has(key)) dots.set(key, { x, rows: [] });
    dots.get(key).rows.push(k);
  });
  const place = (k) => rank.get(k) ?? Infinity;
  for (const dot of dots.values()) dot.rows.sort((a, b) => place(a) - place(b));
  return [...dots.values()];
}

/** The nodes of a surface in its order, their first two parameters. */
function nodesOf(surface, axes) {
  if (surface === null) return [];
  if (surface.shape === null) return surface.points;
  const steps = (k, i) => axes[k].low + ((axes[k].high - axes[k].low) * i) / Math.max(1, surface.shape[k] - 1);
  if (surface.shape.length === 1) return Array.from({ length: surface.shape[0] }, (_, i) => [steps(0, i)]);
  const [rows, columns] = surface.shape;
  return Array.from({ length: rows * columns }, (_, n) => [steps(0, Math.floor(n / columns)), steps(1, n % columns)]);
}

/** What a map shows: "lattice", "starts" (dots), "profile" (one parameter) or null, where only the bars of starts can. */
function mapKind(story, problem) {
  const starts = problem.surface !== null && problem.surface.shape === null;
  if (story.axes.length === 1) return starts ? null : "profile";
  if (starts) return story.axes.length === 2 ? "starts" : null;
  return "lattice";
}

/** Draw a map; `view` is {story, problem, kind, series, selected, hover}. */
function drawMap(canvas, view) {
  const width = canvas.clientWidth;
  if (width === 0) return;
  const at = placed(view, width);
  const context = prepared(canvas, width, at.height);
  const dots = dotsOf(view.story, view.problem);
  const nodes = nodesOf(view.problem.surface, view.story.axes);
  const full = { ...view, ...at, dots, nodes, scale: scaleOf(view) };
  ({ lattice: drawLattice, starts: drawStarts, profile: drawProfile })[view.kind](context, full);
  drawAxes(context, full, ...axisNames(view));
  drawDots(context, full);
  drawCross(context, full);
  views.set(canvas, full);
  canvas.dataset.tests = view.problem.tests.test.length;
  canvas.dataset.dots = dots.length;
  canvas.dataset.series = view.series;
  canvas.dataset.problem = view.problem.name;
}

function axisNames({ kind, story, problem }) {
  const names = story.axes.map((axis) => withUnit(axis.name, axis.unit));
  return kind === "profile" ? [names[0], withUnit("objective", problem.unit)] : names;
}

/** Box and ranges of a map of this width; parameters of one unit are drawn to scale. */
function placed(view, width) {
  const [first, second] = view.story.axes;
  const bar = view.kind === "profile" ? 12 : 74;
  const box = { x: 44, y: 24, w: Math.max(80, width - 44 - bar), h: 0 };
  const rangeX = padded(view, 0);
  const rangeY = view.kind === "profile" ? profileRange(view.problem) : padded(view, 1);
  const same = view.kind !== "profile" && first.unit === second.unit;
  const ratio = same ? (rangeY[1] - rangeY[0]) / (rangeX[1] - rangeX[0]) : 0.7;
  box.h = box.w * (ratio > 0.4 && ratio < 1.3 ? ratio : 0.7);
  return { ...frame(box, rangeX, rangeY), height: box.y + box.h + 40 };
}

/** Range of a parameter: half a cell more than D around a lattice, a little more around starts. */
function padded(view, k) {
  const { low, high } = view.story.axes[k];
  const nodes = view.problem.surface?.shape?.[k];
  const more = view.kind === "profile" ? 0 : nodes > 1 ? (high - low) / (nodes - 1) / 2 : (high - low) * 0.08 || 0.5;
  return [low - more, high + more];
}

function profileRange(problem) {
  const surface = problem.surface;
  const found = extent(problem.tests.y, ...(surface ? [surface.lower, surface.upper, surface.mean] : [])) ?? [0, 1];
  const more = (found[1] - found[0]) * 0.06 || 0.5;
  return [found[0] - more, found[1] + more];
}

/** Range of the shown values, and their colour: dark is worse, whether that is low or high. */
function scaleOf(view) {
  const values = view.problem.surface?.[view.series] ?? [];
  const range = extent(values);
  if (range === null) return null;
  const [low, high] = range;
  const share = (value) => (high > low ? (value - low) / (high - low) : 0.5);
  const colour = (value) => viridis(view.problem.sense === "max" ? 1 - share(value) : share(value));
  return { low, high, values, colour };
}

function drawLattice(context, view) {
  const { box, scale, problem } = view;
  context.fillStyle = theme().empty;
  context.fillRect(box.x, box.y, box.w, box.h);
  if (scale === null) return;
  const [columns, rows] = problem.surface.shape; // first parameter to the right, second one up
  const cells = new OffscreenCanvas(columns, rows);
  const pixels = new ImageData(columns, rows);
  scale.values.forEach((value, n) => {
    if (value === null) return;
    const [i, j] = [Math.floor(n / rows), n % rows];
    pixels.data.set([...scale.colour(value), 255], 4 * ((rows - 1 - j) * columns + i));
  });
  cells.getContext("2d").putImageData(pixels, 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(cells, box.x, box.y, box.w, box.h);
  drawRegion(context, view, columns, rows);
  drawBar(context, view);
}

/** Hatch the cells that may hold the worst start, and draw the border of their region; nothing where no cell is ruled out. */
function drawRegion(context, view, columns, rows) {
  const worst = view.problem.surface.worst;
  if (worst.every(Boolean) || !worst.some(Boolean)) return;
  const { box } = view;
  const [w, h] = [box.w / columns, box.h / rows];
  const inside = (i, j) => i >= 0 && j >= 0 && i < columns && j < rows && worst[i * rows + j];
  const [region, border] = [new Path2D(), new Path2D()];
  const edge = (x0, y0, x1, y1) => (border.moveTo(x0, y0), border.lineTo(x1, y1));
  for (let i = 0; i < columns; i += 1) {
    for (let j = 0; j < rows; j += 1) {
      if (!inside(i, j)) continue;
      const [x, y] = [box.x + i * w, box.y + (rows - 1 - j) * h];
      region.rect(x, y, w, h);
      if (!inside(i - 1, j)) edge(x, y, x, y + h);
      if (!inside(i + 1, j)) edge(x + w, y, x + w, y + h);
      if (!inside(i, j + 1)) edge(x, y, x + w, y);
      if (!inside(i, j - 1)) edge(x, y + h, x + w, y + h);
    }
  }
  hatch(context, region, box);
  for (const [colour, width] of [["#ffffff", 4], ["#000000", 2]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke(border);
  }
}

function hatch(context, region, box) {
  context.save();
  context.clip(region);
  context.lineWidth = 1;
  for (const [colour, shift] of [["rgba(255, 255, 255, 0.6)", 0], ["rgba(0, 0, 0, 0.35)", 1.2]]) {
    context.strokeStyle = colour;
    for (let d = shift - box.h; d < box.w; d += 9) line(context, box.x + d, box.y + box.h, box.x + d + box.h, box.y);
  }
  context.restore();
}

function drawStarts(context, view) {
  const { problem, scale, nodes } = view;
  if (scale === null) return;
  const tested = new Map(view.dots.map((dot) => [dot.x.join(), radius(dot)]));
  nodes.forEach((x, n) => {
    const value = scale.values[n];
    const fill = value === null ? theme().empty : `rgb(${scale.colour(value)})`;
    const r = 6 + (tested.get(x.join()) ?? 0);
    disc(context, [view.px(x[0]), view.py(x[1])], r, fill, theme().ink, problem.surface.worst[n] ? 2.5 : 0.75);
  });
  drawBar(context, view);
}

function drawProfile(context, view) {
  const { problem, nodes, box } = view;
  if (problem.surface === null) return;
  const { lower, upper, mean, worst } = problem.surface;
  const colours = theme();
  const known = nodes.map((x, n) => n).filter((n) => lower[n] !== null && upper[n] !== null);
  const band = new Path2D();
  known.forEach((n) => band.lineTo(view.px(nodes[n][0]), view.py(upper[n])));
  known.reverse().forEach((n) => band.lineTo(view.px(nodes[n][0]), view.py(lower[n])));
  context.fillStyle = `${colours.blue}33`;
  context.fill(band);
  const curve = new Path2D();
  nodes.forEach((x, n) => mean[n] !== null && curve.lineTo(view.px(x[0]), view.py(mean[n])));
  context.strokeStyle = colours.blue;
  context.lineWidth = 2;
  context.stroke(curve);
  if (worst.every(Boolean)) return;
  context.fillStyle = colours.red;
  const cell = box.w / Math.max(1, nodes.length - 1);
  context.save();
  context.beginPath();
  context.rect(box.x, box.y, box.w, box.h);
  context.clip();
  nodes.forEach((x, n) => worst[n] && context.fillRect(view.px(x[0]) - cell / 2, box.y + box.h - 5, cell, 5));
  context.restore();
}

/** The colour bar at the right: which number a colour stands for. */
function drawBar(context, view) {
  const { box, scale, problem, series } = view;
  const colours = theme();
  const [x, width] = [box.x + box.w + 14, 12];
  const at = frame({ x, y: box.y, w: width, h: box.h }, [0, 1], [scale.low, scale.high]);
  for (let y = 0; y < box.h; y += 1) {
    context.fillStyle = `rgb(${scale.colour(at.iy(box.y + y + 0.5))})`;
    context.fillRect(x, box.y + y, width, 1.5);
  }
  context.fillStyle = colours.ink;
  context.strokeStyle = colours.muted;
  context.lineWidth = 1;
  context.textAlign = "left";
  context.textBaseline = "middle";
  const values = scale.high > scale.low ? ticks(scale.low, scale.high, box.h / 45) : [[scale.low, num(scale.low)]];
  for (const [value, text] of values) {
    line(context, x + width, at.py(value), x + width + 3, at.py(value));
    context.fillText(text, x + width + 6, at.py(value));
  }
  context.textAlign = "right";
  context.textBaseline = "bottom";
  context.fillText(withUnit(series, problem.unit), x + 60, box.y - 6, 74);
  context.textBaseline = "top";
  context.fillStyle = colours.muted;
  context.fillText("dark = worse", x + 60, box.y + box.h + 22, 74);
}

/** Where a dot stands on its map. */
function dotAt(view, dot) {
  const y = view.kind === "profile" ? view.problem.tests.y[dot.rows[0]] : dot.x[1];
  return [view.px(dot.x[0]), view.py(y ?? view.rangeY[0])];
}

function radius(dot) {
  return Math.min(3 + 1.1 * Math.sqrt(dot.rows.length - 1), 8);
}

function drawDots(context, view) {
  const { problem, dots, selected } = view;
  const last = problem.tests.test.length - 1;
  const worst = worstFirst(view.story, problem)[0];
  const plain = dots.filter((dot) => !dot.rows.includes(worst) && view.kind !== "starts"); // a start is its own dot
  for (const dot of plain) disc(context, dotAt(view, dot), radius(dot), "#ffffff", "#000000");
  for (const dot of dots) {
    const around = radius(dot) + (view.kind === "starts" ? 9 : 4);
    if (dot.rows.includes(worst)) disc(context, dotAt(view, dot), Math.min(radius(dot) + 2, 7), "#d55e00", "#ffffff");
    if (dot.rows.includes(0)) square(context, dotAt(view, dot), around, 0);
    if (dot.rows.includes(last)) square(context, dotAt(view, dot), around, Math.PI / 4);
  }
  const chosen = dots.find((dot) => dot.rows.some((k) => problem.tests.test[k] === selected));
  if (chosen) ring(context, dotAt(view, chosen), radius(chosen) + (view.kind === "starts" ? 13 : 9));
}

function disc(context, [x, y], r, fill, edge, width = 1.2) {
  context.beginPath();
  context.arc(x, y, r, 0, 2 * Math.PI);
  context.fillStyle = fill;
  context.strokeStyle = edge;
  context.lineWidth = width;
  context.fill();
  context.stroke();
}

/** A thin square around the first test, standing on its corner around the last one. */
function square(context, [x, y], r, angle) {
  context.save();
  context.translate(x, y);
  context.rotate(angle);
  outlined(context, () => context.strokeRect(-r, -r, 2 * r, 2 * r));
  context.restore();
}

function ring(context, [x, y], r) {
  outlined(context, () => {
    context.beginPath();
    context.arc(x, y, r, 0, 2 * Math.PI);
    context.stroke();
  });
}

/** Stroke in black with a white edge: seen on every colour. */
function outlined(context, stroke) {
  for (const [colour, width] of [["#ffffff", 4], ["#000000", 1.8]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    stroke();
  }
}

function drawCross(context, view) {
  if (!view.hover) return;
  const { box } = view;
  const [x, y] = view.hover;
  context.strokeStyle = theme().ink;
  context.lineWidth = 0.75;
  context.setLineDash([3, 3]);
  line(context, x, box.y, x, box.y + box.h);
  if (view.kind !== "profile") line(context, box.x, y, box.x + box.w, y);
  context.setLineDash([]);
}

/** The dot nearest to a pixel, or null if none is within reach. */
function dotNear(view, [x, y]) {
  let [best, least] = [null, REACH];
  for (const dot of view.dots) {
    const [a, b] = dotAt(view, dot);
    const far = Math.hypot(a - x, b - y);
    if (far < least) [best, least] = [dot, far];
  }
  return best;
}

/** The node nearest to a pixel, or -1 outside of the map. */
function nodeNear(view, [x, y]) {
  const { box } = view;
  if (x < box.x || x > box.x + box.w || y < box.y || y > box.y + box.h) return -1;
  let [best, least] = [-1, Infinity];
  view.nodes.forEach((node, n) => {
    const far = Math.hypot(view.px(node[0]) - x, view.kind === "profile" ? 0 : view.py(node[1]) - y);
    if (far < least) [best, least] = [n, far];
  });
  return best;
}

/** What the map says of a pixel, in words. */
function readout(view, pixel) {
  const { story, problem } = view;
  const [dot, n] = [dotNear(view, pixel), nodeNear(view, pixel)];
  const parts = [];
  if (dot) parts.push(`${place(dot.x, story.axes)}: ${dotWords(problem, dot)}`);
  if (n >= 0 && problem.surface) {
    const { mean, lower, upper } = problem.surface;
    const values = [["mean", mean[n]], ["lower", lower[n]], ["upper", upper[n]]].filter(([, value]) => value !== null);
    const said = values.map(([name, value]) => `${name} ${quantity(value, problem.unit)}`).join(", ");
    parts.push(`${place(view.nodes[n], story.axes)}: ${said || "nothing is known"}`);
  }
  return parts.join("\n");
}

function dotWords(problem, dot) {
  const { test, y } = problem.tests;
  const first = `test ${test[dot.rows[0]]} observed ${quantity(y[dot.rows[0]], problem.unit)}`;
  return dot.rows.length === 1 ? first : `${dot.rows.length} tests, of which ${first}, the worst`;
}

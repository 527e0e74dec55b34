// Drawing of a map of D on a canvas, from its model in map-model.js.

const mapModels = new WeakMap(); // canvas -> model
const TICK = 6; // pixels: on the line around the possible worst starts, to their side
const [WHITE, BLACK, WORST] = ["#ffffff", "#000000", "#d55e00"]; // on viridis, in both colour schemes

/** Draw a map over the width of its canvas; `view` as in `mapModel`. */
function drawMap(canvas, view) {
  const width = canvas.clientWidth;
  if (width === 0) return; // hidden
  const model = mapModel(view, width);
  const context = canvasContext(canvas, width, model.height);
  ({ lattice: drawLattice, starts: drawStarts, profile: drawProfile })[model.kind](context, model);
  drawAxes(context, model);
  drawDots(context, model);
  drawFailing(context, model);
  drawCrosshair(context, model);
  mapModels.set(canvas, model);
  const { problem, series, chosen } = model;
  Object.assign(canvas.dataset, { tests: problem.tests.test.length, series, problem: problem.name, axes: chosen.join() });
}

/** Give a canvas `width` by `height` CSS pixels, sharp on this screen; returns its cleared context. */
function canvasContext(canvas, width, height) {
  const ratio = Math.min(window.devicePixelRatio || 1, 3);
  canvas.style.aspectRatio = `${width} / ${height}`; // paper may be narrower than the screen
  // Assigning a size clears and reallocates a canvas, even if it is the same.
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = FONT;
  return context;
}

function drawLattice(context, model) {
  const { box, scale, band } = model;
  context.fillStyle = theme().empty;
  context.fillRect(box.left, box.top, box.width, box.height);
  if (scale === null) return;
  const [columns, rows] = band.shape;
  const cells = new OffscreenCanvas(columns, rows);
  const pixels = new ImageData(columns, rows);
  scale.values.forEach((value, n) => {
    if (value === null) return;
    const [i, j] = [Math.floor(n / rows), n % rows];
    // Rows of an image run downwards, the second parameter upwards.
    pixels.data.set([...scale.colour(value), 255], 4 * ((rows - 1 - j) * columns + i));
  });
  cells.getContext("2d").putImageData(pixels, 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(cells, box.left, box.top, box.width, box.height);
  if (model.region !== null) drawRegion(context, box, model.region, columns, rows);
  drawColourBar(context, model);
}

/** Draw a line around the cells that may contain the worst start, with ticks to their side: colours stay what they are. */
function drawRegion(context, box, edges, columns, rows) {
  const { toX, toY } = frame(box, [0, columns], [0, rows]);
  const border = new Path2D();
  for (const [i, j, nextI, nextJ, inI, inJ] of edges) {
    border.moveTo(toX(i), toY(j));
    border.lineTo(toX(nextI), toY(nextJ));
    const [x, y] = [(toX(i) + toX(nextI)) / 2, (toY(j) + toY(nextJ)) / 2];
    border.moveTo(x, y);
    // Ticks to one side: hatching and shading change the colours, and of dashes nobody sees which side is meant.
    border.lineTo(x + TICK * inI, y - TICK * inJ);
  }
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.width, box.height);
  context.clip();
  strokeOutlined(context, 1.8, () => context.stroke(border));
  context.restore();
}

function drawStarts(context, model) {
  const { band, scale, nodes, problem, chosen, toX, toY } = model;
  if (scale === null) return;
  const many = nodes.length > MANY_DOTS;
  const radii = new Map(model.dots.map((dot) => [dot.x.join(), dot.radius]));
  const order = nodes.map((_, n) => n);
  // The worst ones on top.
  if (many) order.sort((a, b) => (problem.sense === "max" ? 1 : -1) * (scale.values[a] - scale.values[b]));
  for (const n of order) {
    const x = chosen.map((k) => nodes[n][k]);
    const value = scale.values[n];
    const fill = value === null ? theme().empty : `rgb(${scale.colour(value)})`;
    const possible = band.worst[n];
    const [radius, edge] = many ? [possible ? 3.5 : 2, possible ? 1.5 : 0.3] : [6 + (radii.get(x.join()) ?? 0), possible ? 2.5 : 0.75];
    disc(context, [toX(x[0]), toY(x[1])], radius, fill, theme().ink, edge);
  }
  drawColourBar(context, model);
}

function drawProfile(context, model) {
  const { box } = model;
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.width, box.height); // the band may go beyond
  context.clip();
  if (model.band !== null) drawBand(context, model);
  drawProfileLevels(context, model);
  context.restore();
}

/** The requirement, the clip and the last bound as lines with their names. */
function drawProfileLevels(context, { problem, box, rangeY, toY }) {
  const colours = theme();
  const shown = boundLevels(problem).filter(({ value }) => value >= rangeY[0] && value <= rangeY[1]);
  const rows = spread(shown.map(({ value }) => toY(value) - 8), LABEL_HEIGHT, box.top + 8, box.top + box.height - 12);
  shown.forEach(({ value, label, colour, dash }, k) => {
    context.strokeStyle = colours[colour];
    context.lineWidth = 1.2;
    context.setLineDash(dash ?? []);
    line(context, box.left, toY(value), box.left + box.width, toY(value));
    context.setLineDash([]);
    align(context, "right", "middle");
    context.strokeStyle = colours.paper;
    context.lineWidth = 4;
    context.strokeText(label, box.left + box.width - 6, rows[k]);
    context.fillStyle = colours.ink;
    context.fillText(label, box.left + box.width - 6, rows[k]);
  });
}

function drawBand(context, { band, nodes, box, toX, toY }) {
  const { lower, upper, mean, worst } = band;
  const colours = theme();
  const bounded = nodes.map((x, n) => n).filter((n) => lower[n] !== null && upper[n] !== null);
  const area = new Path2D();
  bounded.forEach((n) => area.lineTo(toX(nodes[n][0]), toY(upper[n])));
  bounded.reverse().forEach((n) => area.lineTo(toX(nodes[n][0]), toY(lower[n])));
  context.fillStyle = `${colours.blue}33`;
  context.fill(area);
  const curve = new Path2D();
  nodes.forEach((x, n) => mean[n] !== null && curve.lineTo(toX(x[0]), toY(mean[n])));
  context.strokeStyle = colours.blue;
  context.lineWidth = 2;
  context.stroke(curve);
  if (worst.every(Boolean)) return; // no start is ruled out: the strip would carry no information
  context.fillStyle = colours.red;
  const cell = box.width / Math.max(1, nodes.length - 1);
  nodes.forEach((x, n) => worst[n] && context.fillRect(toX(x[0]) - cell / 2, box.top + box.height - 5, cell, 5));
}

/** Border, ticks and names of both axes. */
function drawAxes(context, { kind, axes, problem, box, rangeX, rangeY, toX, toY }) {
  const { left, top, width, height } = box;
  const colours = theme();
  const [nameX, nameY] = axes.map((axis) => withUnit(axis.name, axis.unit));
  context.strokeStyle = colours.muted;
  context.fillStyle = colours.ink;
  context.lineWidth = 1;
  context.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
  align(context, "center", "top");
  for (const [value, text] of ticks(...rangeX, Math.max(2, width / 70))) {
    line(context, toX(value), top + height, toX(value), top + height + 4);
    context.fillText(text, toX(value), top + height + 6);
  }
  context.fillText(nameX, left + width / 2, top + height + 22, width);
  if (kind === "strip") return; // one parameter, and no objective
  align(context, "right", "middle");
  for (const [value, text] of ticks(...rangeY, Math.max(2, height / 45))) {
    line(context, left - 4, toY(value), left, toY(value));
    context.fillText(text, left - 6, toY(value));
  }
  align(context, "left", "bottom");
  context.fillText(kind === "profile" ? withUnit(valueName(problem), problem.unit) : nameY, 2, top - 6, left + width);
}

/** The colour bar at the right, with the numbers of its colours. */
function drawColourBar(context, { box: { left, top, width, height }, scale, problem, series }) {
  const colours = theme();
  const bar = { left: left + width + 14, top, width: 12, height };
  const right = bar.left + bar.width;
  const { toY } = frame(bar, [0, 1], [scale.low, scale.high]);
  for (let y = 0; y < height; y += 1) {
    context.fillStyle = `rgb(${scale.colour(scale.high - ((y + 0.5) / height) * (scale.high - scale.low))})`;
    context.fillRect(bar.left, top + y, bar.width, 1.5); // overlapping: no seams
  }
  context.fillStyle = colours.ink;
  context.strokeStyle = colours.muted;
  context.lineWidth = 1;
  align(context, "left", "middle");
  const values = scale.high > scale.low ? ticks(scale.low, scale.high, height / 45) : [[scale.low, num(scale.low)]];
  for (const [value, text] of values) {
    line(context, right, toY(value), right + 3, toY(value));
    context.fillText(text, right + 6, toY(value));
  }
  align(context, "right", "bottom");
  context.fillText(withUnit(SERIES_WORDS[series], problem.unit), bar.left + 60, top - 6, MARGIN.bar + 40);
  const limit = comparedWith(problem)?.[0] ?? null;
  if (limit !== null && limit >= scale.low && limit <= scale.high) {
    strokeOutlined(context, 2, () => line(context, bar.left - 5, toY(limit), right + 5, toY(limit)));
  }
  context.textBaseline = "top";
  context.fillStyle = colours.muted;
  context.fillText("dark = worse", bar.left + 60, top + height + 22, MARGIN.bar);
}

/** Whether every listed start is its own dot on a map. */
function ownDots(kind, band) {
  return kind === "starts" && band.points.length <= MANY_DOTS;
}

function drawDots(context, { kind, band, dots, box, problem }) {
  // A listed start is its own dot, unless there are too many. Violations and the worst are drawn on top.
  const own = ownDots(kind, band);
  const edge = dots.length > MANY_DOTS ? 0.6 : 1.2;
  for (const dot of own ? [] : dots.filter((each) => !each.violates)) {
    context.globalAlpha = dot.off ? 0.4 : 1;
    disc(context, dot.at, dot.radius, ...(band ? [WHITE, BLACK] : [dot.colour, theme().empty]), edge);
  }
  for (const dot of own ? [] : dots.filter((each) => each.violates)) {
    context.globalAlpha = dot.off ? 0.6 : 1;
    disc(context, dot.at, Math.max(dot.radius, 2.5), WORST, BLACK, edge);
  }
  context.globalAlpha = 1;
  for (const dot of dots) {
    if (dot.worst) disc(context, dot.at, Math.min(dot.radius + 2, 7), WORST, WHITE);
  }
  for (const [mark, more] of [["selected", 9], ["pointed", 6]]) {
    const dot = dots.find((each) => each[mark]);
    if (dot) strokeOutlined(context, 1.8, () => context.stroke(circle(dot.at, dot.radius + more + (own ? 4 : 0))));
  }
  // Where starts are drawn their order means nothing.
  for (const dot of problem.drawn ? [] : dots) {
    const name = [dot.first && "first", dot.last && "last"].filter(Boolean).join(", ");
    if (name) drawName(context, name, dot.at, dot.radius + (own ? 9 : 4) + (dot.selected ? 8 : 0), box);
  }
}

/** Draw the fresh starts that fail as crosses, the worst one on top. */
function drawFailing(context, { failing }) {
  for (const { at: [x, y], worst, off } of [...failing].reverse()) {
    const reach = worst ? 7 : 5;
    context.globalAlpha = off ? 0.5 : 1;
    context.lineCap = "round";
    for (const [colour, width] of [[WHITE, 5], [worst ? BLACK : WORST, worst ? 4 : 2.5], [WORST, 2.2]]) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      line(context, x - reach, y - reach, x + reach, y + reach);
      line(context, x - reach, y + reach, x + reach, y - reach);
    }
  }
  context.lineCap = "butt";
  context.globalAlpha = 1;
}

function circle([x, y], radius) {
  const path = new Path2D();
  path.arc(x, y, radius, 0, 2 * Math.PI);
  return path;
}

function disc(context, at, radius, fill, edge, width = 1.2) {
  context.fillStyle = fill;
  context.strokeStyle = edge;
  context.lineWidth = width;
  context.fill(circle(at, radius));
  context.stroke(circle(at, radius));
}

/** Write the name of a dot beside it, inside of the map: black with a white edge. */
function drawName(context, name, [x, y], away, { left, top, width, height }) {
  const toLeft = x + away + 60 > left + width;
  align(context, toLeft ? "right" : "left", "middle");
  const at = [name, x + (toLeft ? -away - 2 : away + 2), Math.min(Math.max(y, top + 8), top + height - 8)];
  context.font = FONT.replace("12px", "600 12px");
  context.lineJoin = "round";
  context.strokeStyle = WHITE;
  context.lineWidth = 4;
  context.strokeText(...at);
  context.fillStyle = BLACK;
  context.fillText(...at);
  context.font = FONT;
}

/** Stroke in black with a white edge: visible on every colour. */
function strokeOutlined(context, inner, stroke) {
  for (const [colour, width] of [[WHITE, 4], [BLACK, inner]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    stroke();
  }
}

function drawCrosshair(context, { kind, box: { left, top, width, height }, pointer }) {
  if (!pointer) return;
  const [x, y] = pointer;
  context.strokeStyle = theme().ink;
  context.lineWidth = 0.75;
  context.setLineDash([3, 3]);
  line(context, x, top, x, top + height);
  if (kind !== "profile") line(context, left, y, left + width, y);
  context.setLineDash([]);
}

function align(context, horizontal, baseline) {
  context.textAlign = horizontal;
  context.textBaseline = baseline;
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

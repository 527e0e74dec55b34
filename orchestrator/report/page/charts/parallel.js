// Tests over all parameters at once: parallel coordinates, one axis per parameter and one line per tested start.

const MOST_LINES = 1000; // of more starts the worst half is drawn, and of the others an even choice
const ROW = { least: 20, most: 64, height: 440, top: 10, bottom: 8 }; // pixels
const COLUMN = { share: 0.34, most: 240, number: 58, gap: 8 }; // pixels: names and ends beside the axes
const LINE_REACH = 10; // pixels beside a line that select it

/** The figure of all parameters; two have a map that shows the same. */
function parallelFigure(report, index) {
  const problem = report.problems[index];
  if (report.axes.length < 3 || readAxes(report).length < 2) return null;
  const title = "Tests over all parameters";
  const starts = dotsOf(report, problem).length;
  const half = MOST_LINES / 2;
  const some = `${count(MOST_LINES)} of ${count(starts)} starts are drawn: the worst ${half}, and ${half} of the others, evenly chosen.`;
  return el(
    "figure.map",
    el("figcaption", title),
    el(`canvas#parallel-${index}`, { "data-keep": true, "data-index": index, tabindex: 0, role: "img", "aria-describedby": `read-parallel-${index}`, "aria-label": `${title}: one line per tested start of ${words(problem.name)}. Arrow keys move between tests, the worst first, Enter selects one.` }),
    el(`p.readout#read-parallel-${index}`, { "data-keep": true }, "Point at a line to read its test; select it to plot its rollouts."),
    starts > MOST_LINES ? el("p.muted", some) : null,
    el(
      "ul.legend",
      observedLegend(report, problem),
      violating(report, problem).size ? legendItem("key.violates", "violates the specification") : null,
      legendItem("key.worst", "worst observed"),
      legendItem("key.selected", "selected test"),
    ),
    caption(`Each line is a tested start, which crosses every axis at the value of its parameter; the stronger its colour the worse its observed value.${longInputs(report.axes).length ? ` Not shown: ${longInputs(report.axes).join(", ")}.` : ""}`),
  );
}

/**
 * Everything that a picture of this width draws.
 * @param {{report: object, problem: object, selected: number|null, pointer: [number, number]|null, pointed: number|null}} view
 */
function parallelModel(view, width) {
  const shown = readAxes(view.report);
  const axes = axesOf(view.report, shown);
  const step = Math.min(Math.max(ROW.height / axes.length, ROW.least), ROW.most);
  const names = Math.min(width * COLUMN.share, COLUMN.most, Math.max(...axes.map((axis) => measured(short(axis.name) + unitOf(axis)))));
  const left = names + COLUMN.number + COLUMN.gap;
  const box = { left, top: ROW.top + step / 2, width: Math.max(60, width - left - COLUMN.number), height: step * (axes.length - 1) };
  // Axes below one another: names of 30 characters stand beside them, and a hundred parameters scroll.
  const rows = axes.map(({ low, high }, k) => ({ ...frame(box, [low, high], [0, 1]), y: box.top + k * step }));
  const dots = marked(view, drawnStarts(view)).map((dot) => ({ ...dot, values: shown.map((k) => dot.x[k]), path: shown.map((k, row) => [rows[row].toX(dot.x[k]), rows[row].y]) }));
  const model = { ...view, axes, box, step, names, dots, height: box.top + box.height + step / 2 + ROW.bottom };
  return { ...model, dotAt: (pixel) => lineNear(model, pixel) };
}

/** " (m/s)"; nothing for a number without a unit. */
function unitOf({ unit }) {
  return unitText(unit) && ` (${unitText(unit)})`;
}

/** The tested starts that are drawn, the worst first: the worst half, and an even choice of the others. */
function drawnStarts({ report, problem }) {
  return once(problem, "drawn starts", () => choiceOfStarts(report, problem));
}

function choiceOfStarts(report, problem) {
  const rank = new Map(worstFirst(report, problem).map((row, position) => [row, position]));
  const position = ({ rows }) => rank.get(rows[0]) ?? Infinity; // a test without a value comes last
  const starts = [...dotsOf(report, problem)].sort((a, b) => position(a) - position(b));
  // Thousands of lines, however transparent, are one grey block.
  if (starts.length <= MOST_LINES) return starts;
  const half = MOST_LINES / 2;
  const others = starts.length - half;
  return [...starts.slice(0, half), ...Array.from({ length: half }, (_, k) => starts[half + Math.floor((k * others) / half)])];
}

/** The line nearest to a pixel along the axes, the worst of equal ones; null if none is within reach. */
function lineNear({ dots, box, step }, [x, y]) {
  const row = Math.min(Math.max((y - box.top) / step, 0), box.height / step);
  const above = Math.min(Math.floor(row), Math.max(0, Math.round(box.height / step) - 1));
  const share = row - above;
  const at = ({ path }) => path[above][0] + share * ((path[above + 1] ?? path[above])[0] - path[above][0]);
  return dots[nearest(dots.map((dot) => Math.abs(at(dot) - x)), LINE_REACH)] ?? null;
}

/** Draw the picture over the width of its canvas; `view` as in `parallelModel`. */
function drawParallel(canvas, view) {
  const width = canvas.clientWidth;
  if (width === 0) return; // hidden
  const model = parallelModel(view, width);
  const context = canvasContext(canvas, width, model.height);
  drawStartLines(context, model);
  drawParallelAxes(context, model);
  drawPointedValues(context, model);
  mapModels.set(canvas, model);
  Object.assign(canvas.dataset, { lines: model.dots.length, problem: model.problem.name });
}

function drawStartLines(context, { dots }) {
  const colours = theme();
  const path = ({ path: points }) => {
    const found = new Path2D();
    for (const [x, y] of points) found.lineTo(x, y);
    return found;
  };
  const stroke = (dot, colour, width) => {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke(path(dot));
  };
  const thin = dots.length > MANY_DOTS ? 0.8 : 1.2;
  context.lineJoin = "round";
  // The worst first in the list, last on the canvas.
  context.globalAlpha = dots.length > MANY_DOTS ? 0.6 : 1;
  for (const dot of [...dots].reverse()) if (!dot.violates) stroke(dot, dot.colour, thin);
  for (const dot of [...dots].reverse()) if (dot.violates) stroke(dot, colours.red, thin);
  context.globalAlpha = 1;
  for (const mark of ["worst", "selected", "pointed"]) {
    const dot = dots.find((each) => each[mark]);
    if (!dot) continue;
    if (mark !== "worst") for (const [colour, width] of [[colours.paper, 7], [colours.ink, 5]]) stroke(dot, colour, width);
    stroke(dot, dot.worst ? WORST : dot.violates ? colours.red : dot.colour, 2.6);
  }
}

/** Axes with their names and ends. */
function drawParallelAxes(context, { axes, box, step, names }) {
  const colours = theme();
  const right = box.left + box.width;
  context.lineWidth = 1;
  axes.forEach((axis, k) => {
    const y = box.top + k * step;
    context.strokeStyle = colours.muted;
    line(context, box.left, y, right, y);
    for (const x of [box.left, right]) line(context, x, y - 4, x, y + 4);
    context.fillStyle = colours.ink;
    align(context, "left", "middle");
    context.fillText(fitted(axis, names), 0, y);
    context.fillStyle = colours.muted;
    align(context, "right", "middle");
    context.fillText(num(axis.low), box.left - COLUMN.gap, y, COLUMN.number);
    align(context, "left", "middle");
    context.fillText(num(axis.high), right + COLUMN.gap, y, COLUMN.number - COLUMN.gap);
  });
}

/** The values of the test that the reader points at, on their axes. */
function drawPointedValues(context, { dots, box }) {
  const dot = dots.find((each) => each.pointed);
  if (!dot) return;
  const colours = theme();
  context.strokeStyle = colours.paper;
  context.fillStyle = colours.ink;
  context.lineWidth = 4;
  dot.path.forEach(([x, y], k) => {
    const left = x > box.left + box.width / 2;
    align(context, left ? "right" : "left", "middle");
    const at = [num(dot.values[k]), x + (left ? -7 : 7), y];
    context.strokeText(...at);
    context.fillText(...at);
  });
}

/** A name with its unit, the middle of the name left out where they are wider than `width`: names differ at their ends. */
function fitted(axis, width) {
  const unit = unitOf(axis);
  let kept = axis.name.length;
  while (kept > 3 && measured(shortMiddle(axis.name, kept) + unit) > width) kept -= 1;
  return shortMiddle(axis.name, kept) + unit;
}

/** The width of a text in pixels. */
function measured(text) {
  const context = new OffscreenCanvas(1, 1).getContext("2d");
  context.font = FONT;
  return context.measureText(text).width + 1;
}

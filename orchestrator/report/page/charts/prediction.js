// Predicted against observed values at the fresh starts of the spot check, which the model did not see.

function predictionFigure(problem, index) {
  const { prediction } = problem.charts;
  if (prediction === null) return null;
  const title = "Predicted against observed, at fresh starts";
  const bounded = hasBounds(prediction);
  return el(
    "figure.prediction",
    el("figcaption", title),
    el(`canvas#predicted-${index}`, { "data-keep": true, role: "img", "aria-label": `${title}: ${predictionCaption(problem)}` }),
    el(
      "ul.legend",
      legendItem("mark.seen", bounded ? "observed within the predicted bounds" : "a fresh start"),
      prediction.inside < prediction.starts ? legendItem("mark.missed", "outside of them") : null,
      bounded ? legendItem("key.whisker", "from the lower to the upper bound") : null,
      legendItem("key.diagonal", "as predicted"),
    ),
    caption(predictionCaption(problem)),
  );
}

function hasBounds({ lower, upper }) {
  return [...lower, ...upper].some((value) => value !== null);
}

function predictionCaption(problem) {
  const { prediction } = problem.charts;
  const { starts, inside, noisy, rollouts, interpolated } = prediction;
  const drawn = prediction.observed.length < starts ? ` The picture has ${count(prediction.observed.length)} of them, with those outside.` : "";
  const observed = rollouts === 1 ? "one rollout" : `the mean of ${rollouts} rollouts`;
  const what = `Each point is a fresh start that the model did not see: to the right what its mean predicts, upwards what ${observed} showed.`;
  const noise = noisy ? " The bounds are those of the expectation, and a rollout has noise: a point outside does not refute them by itself." : " Without noise a point outside refutes them.";
  const counted = hasBounds(prediction) ? ` ${count(inside)} of ${count(starts)} are within the predicted bounds.${noise}` : " The model has no bounds here.";
  const between = interpolated ? " The mean is interpolated between the nodes of the grid, the bounds are those of the nearest one." : "";
  return what + counted + between + drawn;
}

/** Draw the points over the width of their canvas. */
function drawPrediction(problem, index) {
  const { prediction, required } = problem.charts;
  const canvas = document.getElementById(`predicted-${index}`);
  if (prediction === null || canvas === null || canvas.clientWidth === 0) return;
  const width = canvas.clientWidth;
  const box = { left: MARGIN.left + 10, top: 14, width: Math.max(80, width - MARGIN.left - 10 - MARGIN.right) };
  box.height = Math.min(box.width * 0.75, 340);
  const { mean, observed } = prediction;
  const range = widened(extent(mean, observed) ?? [0, 1]);
  const rangeX = widened(extent(mean) ?? [0, 1]);
  const at = frame(box, rangeX, range);
  const context = canvasContext(canvas, width, box.top + box.height + MARGIN.bottom);
  drawScatterAxes(context, at, [withUnit("predicted mean", problem.unit), withUnit("observed", problem.unit)]);
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.width, box.height);
  context.clip();
  drawPredictionLines(context, at, required);
  drawPredictionPoints(context, at, prediction);
  context.restore();
  Object.assign(canvas.dataset, { starts: prediction.starts, inside: prediction.inside });
}

function widened([low, high]) {
  const margin = (high - low) * 0.05 || 0.5;
  return [low - margin, high + margin];
}

/** Border, ticks and names of both axes of points. */
function drawScatterAxes(context, { box, rangeX, rangeY, toX, toY }, [nameX, nameY]) {
  const colours = theme();
  const { left, top, width, height } = box;
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
  align(context, "right", "middle");
  for (const [value, text] of ticks(...rangeY, Math.max(2, height / 45))) {
    line(context, left - 4, toY(value), left, toY(value));
    context.fillText(text, left - 6, toY(value));
  }
  context.save();
  context.translate(9, top + height / 2);
  context.rotate(-Math.PI / 2);
  align(context, "center", "middle");
  context.fillText(nameY, 0, 0, height);
  context.restore();
}

function drawPredictionLines(context, { box, rangeX, toX, toY }, required) {
  const colours = theme();
  context.strokeStyle = colours.ink;
  context.lineWidth = 1;
  context.setLineDash([6, 4]);
  line(context, toX(rangeX[0]), toY(rangeX[0]), toX(rangeX[1]), toY(rangeX[1]));
  if (required !== null) {
    context.strokeStyle = colours.red;
    context.setLineDash([7, 4]);
    line(context, box.left, toY(required), box.left + box.width, toY(required));
    context.setLineDash([]);
    context.fillStyle = colours.red;
    align(context, "right", "bottom");
    context.strokeStyle = colours.paper;
    context.lineWidth = 4;
    const label = [`required ${num(required)}`, box.left + box.width - 4, toY(required) - 3];
    context.strokeText(...label);
    context.fillText(...label);
  }
  context.setLineDash([]);
}

function drawPredictionPoints(context, { box, toX, toY }, { mean, observed, lower, upper, outside }) {
  const colours = theme();
  const many = mean.length > MANY_DOTS;
  const bottom = box.top + box.height;
  const order = mean.map((_, k) => k).sort((a, b) => outside[a] - outside[b]); // those outside on top
  for (const k of order) {
    if (mean[k] === null) continue;
    const x = toX(mean[k]);
    if (lower[k] !== null || upper[k] !== null) {
      context.strokeStyle = outside[k] ? colours.red : colours.muted;
      context.globalAlpha = outside[k] ? 0.8 : mean.length > 150 ? 0.12 : 0.22;
      context.lineWidth = 1;
      line(context, x, lower[k] === null ? bottom : toY(lower[k]), x, upper[k] === null ? box.top : toY(upper[k]));
      context.globalAlpha = 1;
    }
    if (outside[k]) cross(context, [x, toY(observed[k])], 4, colours.red);
    else disc(context, [x, toY(observed[k])], many ? 1.8 : 2.4, colours.blue, colours.paper, 0.6);
  }
}

/** A mark that is told from a dot without its colour. */
function cross(context, [x, y], half, colour) {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  line(context, x - half, y - half, x + half, y + half);
  line(context, x - half, y + half, x + half, y - half);
}

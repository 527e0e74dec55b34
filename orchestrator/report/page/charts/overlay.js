// Lines over a chart with their names beside it: levels of its values, and the test after which a problem stopped.

const GUTTER = [96, 150]; // pixels to the right of a chart, for the names of its levels: at least, and at most
const LABEL_HEIGHT = 14; // pixels between two names

/**
 * Draw levels and stop over a chart, without rebuilding it.
 * @param {{levels: Array<{value: number, label: string, colour: string, dash?: number[]}>, stop?: {at: number, label: string}}} overlay
 *   colours are names of the theme; `stop` is at a value of x
 */
function drawOverlay(plot, overlay, colours) {
  const { ctx, bbox } = plot;
  const ratio = uPlot.pxRatio;
  ctx.save();
  ctx.font = FONT.replace("12px", `${12 * ratio}px`);
  if (overlay.stop) drawStop(ctx, plot, overlay.stop, colours);
  const shown = overlay.levels.map((level) => ({ ...level, y: plot.valToPos(level.value, "y", true) })).filter(({ y }) => y >= bbox.top - 1 && y <= bbox.top + bbox.height + 1);
  const rows = spread(shown.map(({ y }) => y), LABEL_HEIGHT * ratio, bbox.top, bbox.top + bbox.height);
  const room = gutter(overlay);
  shown.forEach(({ y, label, colour, dash, wide }, k) => {
    const right = bbox.left + bbox.width;
    ctx.strokeStyle = colours[colour];
    ctx.lineWidth = (wide ? 1.6 : 1) * ratio;
    ctx.setLineDash((dash ?? []).map((each) => each * ratio));
    line(ctx, bbox.left, y, right, y);
    ctx.setLineDash([]);
    ctx.lineWidth = ratio;
    line(ctx, right, y, right + 6 * ratio, rows[k]);
    ctx.fillStyle = colours.ink;
    align(ctx, "left", "middle");
    ctx.fillText(label, right + 9 * ratio, rows[k], (room - 10) * ratio);
  });
  ctx.restore();
}

/** The pixels that the names of the levels need, within limits. */
function gutter({ levels }) {
  return Math.min(Math.max(GUTTER[0], ...levels.map(({ label }) => Math.ceil(textWidth(label)) + 10)), GUTTER[1]);
}

function drawStop(ctx, plot, { at, label }, colours) {
  const { bbox } = plot;
  const x = Math.round(plot.valToPos(at, "x", true));
  if (x < bbox.left || x > bbox.left + bbox.width + 1) return;
  ctx.strokeStyle = colours.muted;
  ctx.lineWidth = uPlot.pxRatio;
  line(ctx, x, bbox.top - 4 * uPlot.pxRatio, x, bbox.top + bbox.height);
  ctx.fillStyle = colours.muted;
  const left = x - bbox.left > bbox.width / 2;
  align(ctx, left ? "right" : "left", "bottom");
  ctx.fillText(label, x, bbox.top - 5 * uPlot.pxRatio);
}

/**
 * Places at least `least` apart, near to the wanted ones and in their order, between `top` and `bottom` where they fit.
 * @param {number[]} wanted in any order
 */
function spread(wanted, least, top, bottom) {
  const order = wanted.map((_, k) => k).sort((a, b) => wanted[a] - wanted[b]);
  const places = [...wanted];
  order.forEach((k, n) => {
    if (n > 0) places[k] = Math.max(places[k], places[order[n - 1]] + least);
  });
  let limit = bottom;
  for (const k of order.toReversed()) {
    places[k] = Math.min(places[k], limit);
    limit = places[k] - least;
  }
  const above = order.length ? top - places[order[0]] : 0;
  return above > 0 && order.length * least <= bottom - top ? places.map((each) => each + above) : places;
}

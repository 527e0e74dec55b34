// Colours of maps and charts; uPlot charts that get new data instead of being rebuilt.

/** Colours of Okabe and Ito, distinct in colour blindness too; lighter ones on a dark page. */
const LIGHT = {
  ink: "#1a1d21", muted: "#555c66", line: "#d9dde2", paper: "#ffffff", empty: "#e9ebee",
  blue: "#0072b2", red: "#c24f00", weak: "#c3daea", strong: "#08306b",
};
const DARK = {
  ink: "#e8eaed", muted: "#a9b1ba", line: "#353b43", paper: "#15181c", empty: "#2a2f36",
  blue: "#56b4e9", red: "#f28e4b", weak: "#31495c", strong: "#d4ecfb",
};
const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';
const AXIS = 52; // pixels beside a chart, for the numbers of its axis
const onPaper = window.matchMedia("print");
const dark = window.matchMedia("(prefers-color-scheme: dark)");
let printing = false;

/** The current colours; paper is light. */
function theme() {
  return dark.matches && !onPaper.matches && !printing ? DARK : LIGHT;
}

const charts = new Map(); // element -> {plot, key, overlay}

/**
 * Draw a chart in its element. A present chart of the same spec and colours gets the new data only.
 * @param {HTMLElement} host
 * @param {{height: number, x: string, y: {label: string, log?: boolean, fromZero?: boolean, range?: [number, number]},
 *   series: Array<{label: string, colour: string, dash?: number[], width?: number, points?: boolean, size?: number, bars?: boolean, unit?: string, sense?: string}>,
 *   legend?: boolean, range?: [number, number], lines?: Array<{value: number, colour: string, label?: string}>}} spec colours are
 *   names of the theme; `range` is that of x, `lines` are drawn upright at values of x
 * @param {Array<Array<number|null>>} data x first
 * @param {(plot: object) => void} [onPointer] called when the pointer moves
 * @param {{range?: [number, number], levels: object[], stop?: object}|null} [overlay] see `drawOverlay`; `range` is that of y
 */
function chart(host, spec, data, onPointer, overlay = null) {
  const colours = theme();
  const key = JSON.stringify([spec, colours.paper]);
  const present = charts.get(host);
  if (present?.key === key) {
    present.overlay = overlay;
    present.onPointer = onPointer;
    present.plot.setData(data);
    return;
  }
  present?.plot.destroy();
  const entry = { key, overlay, onPointer };
  const hooks = {
    setCursor: [(plot) => entry.onPointer?.(plot)],
    draw: [(plot) => drawLines(plot, spec.lines ?? [], colours), (plot) => entry.overlay && drawOverlay(plot, entry.overlay, colours)],
  };
  entry.plot = new uPlot({ ...chartOptions(host, spec, colours, entry), hooks }, data, host);
  charts.set(host, entry);
}

function chartOptions(host, spec, colours, entry = { overlay: null }) {
  const ownRange = spec.y.range ?? (spec.y.fromZero ? (plot, low, high) => [0, 1.05 * high] : undefined);
  const axis = (extra) => ({
    stroke: colours.ink, font: FONT, labelFont: FONT, labelSize: 18, labelGap: 0,
    grid: { stroke: colours.line, width: 1 }, ticks: { stroke: colours.line, width: 1, size: 4 }, ...extra,
  });
  const names = (plot, splits) => splits.map((value) => (value === null ? "" : num(value)));
  return {
    width: Math.max(host.clientWidth, 200),
    height: spec.height,
    cursor: { drag: { x: false, y: false }, points: { size: 7 } },
    legend: { show: spec.legend !== false },
    scales: { x: { time: false, range: spec.range }, y: { distr: spec.y.log ? 3 : 1, range: entry.overlay?.range ? () => entry.overlay.range : ownRange } },
    padding: entry.overlay ? [18, () => gutter(entry.overlay), null, null] : undefined,
    axes: [axis({ label: spec.x, size: 30, space: numberSpace, values: names }), axis({ label: spec.y.label, size: axisWidth, values: names })],
    series: [{ label: spec.x, colour: "ink" }, ...spec.series].map((each) => chartSeries(each, colours)),
  };
}

/** The pixels from one number of a lower axis to the next, at least: more for long ones, which would touch. */
function numberSpace(plot, k, low, high) {
  return Math.max(50, 16 + textWidth(num(high)));
}

/** The width of an axis beside its label, in pixels: more for long numbers, which would be under the label. */
function axisWidth(plot, texts, k, cycle) {
  if (cycle > 1) return plot.axes[k]._size; // as uPlot advises: else widths and numbers may change one another without end
  return Math.max(AXIS, Math.ceil(10 + Math.max(0, ...(texts ?? []).map(textWidth))));
}

const measure = document.createElement("canvas").getContext("2d");

/** The width of a text in a chart, in pixels. */
function textWidth(text) {
  measure.font = FONT;
  return measure.measureText(text).width;
}

function chartSeries(each, colours) {
  return {
    label: each.label,
    stroke: colours[each.colour],
    width: each.width ?? 1.5,
    dash: each.dash,
    spanGaps: true,
    paths: each.points ? () => null : each.bars ? uPlot.paths.bars({ size: [0.96, Infinity] }) : undefined,
    fill: each.bars ? colours[each.colour] : undefined,
    points: { show: each.points === true, size: each.size ?? 3, width: 0, fill: colours[each.colour] },
    value: (plot, value, k, row) => legendText(row === null || row === undefined ? plot.data[k].at(-1) : value, each),
  };
}

/** Upright lines at values of x, over the chart. */
function drawLines(plot, lines, colours) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.font = `${12 * uPlot.pxRatio}px system-ui, sans-serif`;
  ctx.textAlign = "center";
  let last = -Infinity; // of the labels: close ones go below each other
  let row = 0;
  for (const { value, colour, label } of [...lines].sort((a, b) => a.value - b.value)) {
    const x = Math.round(plot.valToPos(value, "x", true)) + 0.5;
    if (x < bbox.left || x > bbox.left + bbox.width) continue;
    ctx.strokeStyle = colours[colour];
    ctx.fillStyle = colours[colour];
    if (label) {
      row = x - last < 12 * uPlot.pxRatio ? row + 1 : 0;
      last = x;
      ctx.fillText(label, x + 6 * uPlot.pxRatio, bbox.top + (12 + 13 * row) * uPlot.pxRatio);
    }
    ctx.setLineDash([5 * uPlot.pxRatio, 3 * uPlot.pxRatio]);
    ctx.lineWidth = uPlot.pxRatio;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}

/** The value at the pointer, without a pointer the last one; that of a bound is rounded to the safe side. */
function legendText(value, { sense, unit }) {
  return sense ? boundText(value, sense, unit) : quantity(value, unit);
}

/** Fit the charts to their elements, and destroy those without one: uPlot keeps listeners on the window. */
function tidyCharts() {
  for (const [host, { plot }] of charts) {
    if (!host.isConnected) {
      plot.destroy();
      charts.delete(host);
    } else if (host.clientWidth > 0 && plot.width !== host.clientWidth) {
      plot.setSize({ width: host.clientWidth, height: plot.height });
    }
  }
}

/** The sentence below a picture: what one sees, and how to read it. */
function caption(text) {
  return el("p.caption", sentence(text));
}

/** A figure with an element for a chart; `chart` draws into it. */
function chartFigure(id, title, ...more) {
  return el("figure", el("figcaption", title), el("div.chart", { id, "data-keep": true, role: "img", "aria-label": title }), more);
}

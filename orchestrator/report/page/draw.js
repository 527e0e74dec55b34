"use strict";
// What maps and charts share: colours, canvases, axes, and uPlot charts that are kept and not made anew.

/** Viridis in ten steps: even to the eye, also without colour. */
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
];
/** Okabe and Ito's colours, which colour-blind people tell apart; lighter ones on a dark page. */
const LIGHT = {
  ink: "#1a1d21", muted: "#555c66", line: "#d9dde2", paper: "#ffffff", empty: "#e9ebee",
  blue: "#0072b2", red: "#c24f00", green: "#00795a", purple: "#a8518a",
};
const DARK = {
  ink: "#e8eaed", muted: "#a9b1ba", line: "#353b43", paper: "#15181c", empty: "#2a2f36",
  blue: "#56b4e9", red: "#f28e4b", green: "#2fc79b", purple: "#dd9fc6",
};
const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';
const onPaper = window.matchMedia("print");
const dark = window.matchMedia("(prefers-color-scheme: dark)");
let printing = false;

/** The colours of this moment; paper is light. */
function theme() {
  return dark.matches && !onPaper.matches && !printing ? DARK : LIGHT;
}

/** Colour of a share between 0 and 1 as [r, g, b]. */
function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const k = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return VIRIDIS[k].map((value, c) => Math.round(value + (at - k) * (VIRIDIS[k + 1][c] - value)));
}

/** Make a canvas `width` by `height` CSS pixels, sharp on this screen; returns its context, cleared. */
function prepared(canvas, width, height) {
  const ratio = Math.min(window.devicePixelRatio || 1, 3);
  canvas.style.aspectRatio = `${width} / ${height}`; // paper may be narrower than the screen
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = FONT;
  return context;
}

/**
 * Where data stand on a canvas.
 * @param {{x: number, y: number, w: number, h: number}} box in CSS pixels
 * @param {[number, number]} rangeX @param {[number, number]} rangeY
 */
function frame(box, rangeX, rangeY) {
  const [spanX, spanY] = [rangeX[1] - rangeX[0] || 1, rangeY[1] - rangeY[0] || 1];
  return {
    box, rangeX, rangeY,
    px: (value) => box.x + ((value - rangeX[0]) / spanX) * box.w,
    py: (value) => box.y + box.h - ((value - rangeY[0]) / spanY) * box.h,
    ix: (pixel) => rangeX[0] + ((pixel - box.x) / box.w) * spanX,
    iy: (pixel) => rangeY[0] + ((box.y + box.h - pixel) / box.h) * spanY,
  };
}

/** Border, ticks and names of both axes. */
function drawAxes(context, at, nameX, nameY) {
  const { box } = at;
  const colours = theme();
  context.strokeStyle = colours.muted;
  context.fillStyle = colours.ink;
  context.lineWidth = 1;
  context.strokeRect(box.x - 0.5, box.y - 0.5, box.w + 1, box.h + 1);
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const [value, text] of ticks(...at.rangeX, Math.max(2, box.w / 70))) {
    line(context, at.px(value), box.y + box.h, at.px(value), box.y + box.h + 4);
    context.fillText(text, at.px(value), box.y + box.h + 6);
  }
  context.fillText(nameX, box.x + box.w / 2, box.y + box.h + 22, box.w);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const [value, text] of ticks(...at.rangeY, Math.max(2, box.h / 45))) {
    line(context, box.x - 4, at.py(value), box.x, at.py(value));
    context.fillText(text, box.x - 6, at.py(value));
  }
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillText(nameY, 2, box.y - 6, box.x + box.w);
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

const charts = new Map(); // element -> {plot, key}

/**
 * Draw a chart in its element: the one that stands there gets new data, unless its build changed.
 * @param {HTMLElement} host
 * @param {{height: number, x: {label: string, name?: string}, y: {label: string, log?: boolean, range?: [number, number]},
 *   series: Array<{label: string, colour: string, dash?: number[], width?: number, points?: boolean, unit?: string}>,
 *   legend?: boolean}} spec colours are names of the theme
 * @param {Array<Array<number|null>>} data x first
 * @param {(plot: object) => void} [pointed] called when the pointer moves
 */
function chart(host, spec, data, pointed) {
  const colours = theme();
  const key = JSON.stringify([spec, colours.paper]);
  const present = charts.get(host);
  if (present?.key === key) {
    present.plot.setData(data);
    return;
  }
  present?.plot.destroy();
  const plot = new uPlot({ ...chartOptions(host, spec, colours), hooks: { setCursor: pointed ? [pointed] : [] } }, data, host);
  charts.set(host, { plot, key });
}

function chartOptions(host, spec, colours) {
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
    scales: { x: { time: false }, y: { distr: spec.y.log ? 3 : 1, range: spec.y.range ? () => spec.y.range : undefined } },
    axes: [axis({ label: spec.x.label, size: 30, values: names }), axis({ label: spec.y.label, size: 52, values: names })],
    series: [{ label: spec.x.name ?? spec.x.label, value: (plot, value, k, row) => num(shownValue(plot, value, k, row)) }, ...spec.series.map((each) => chartSeries(each, colours))],
  };
}

function chartSeries(each, colours) {
  return {
    label: each.label,
    stroke: colours[each.colour],
    width: each.width ?? 1.5,
    dash: each.dash,
    spanGaps: true,
    paths: each.points ? () => null : undefined,
    points: { show: each.points === true, size: 3, width: 0, fill: colours[each.colour] },
    value: (plot, value, k, row) => quantity(shownValue(plot, value, k, row), each.unit),
  };
}

/** What a legend says: the value under the pointer, else the last one. */
function shownValue(plot, value, k, row) {
  return row === null || row === undefined ? plot.data[k].at(-1) : value;
}

/** Fit the charts to their elements, and end those whose element has left the page. */
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

/** An element for a chart; what it shows is said in `label`. */
function chartHost(id, label) {
  return el("div.chart", { id, "data-keep": id, role: "img", "aria-label": label });
}

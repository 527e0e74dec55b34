// Charts of the selected test: one of each column and one of the robustness over time, with one range of time for all.

/** What the reader has chosen for the charts of a test. */
const curveView = {
  test: null, // "problem:test" that the choices below, the columns excepted, are for
  columns: new Set(), // further columns that are shown
  hidden: new Set(), // keys of rollouts that are switched off
  focused: null, // key of the highlighted rollout
  range: null, // [from, to] in s, null: the whole time
};
const CURVE_COLOURS = 4; // c0 to c3 of the styles, then the colour of text
const WORST_WIDTH = 3;
const ZOOMS = [["in", "+", "Zoom in"], ["out", "\u2212", "Zoom out"], ["earlier", "\u2190", "Earlier"], ["later", "\u2192", "Later"], ["whole", "Whole time", "Whole time"]];
const TIMES = { in: 0.5, out: 2 };
const ATTAINED = {
  least: "Its least value is the robustness of the rollout.",
  greatest: "Its greatest value is the robustness of the rollout.",
  first: "It is evaluated from each moment on; the value at the first moment is the robustness of the rollout.",
};
const curvePlots = new Map(); // id of an element -> {plot, of: {column, unit, rollouts, moments}}

/** Forget the choices that belong to another test. */
function turnToTest(key) {
  if (curveView.test !== key) Object.assign(curveView, { test: key, hidden: new Set(), focused: null, range: null });
}

const curveKey = (trace) => trace.rollout || trace.label;

/**
 * The rollouts with curves, each with a colour and a line of its own: a nominal one is dashed, in the colour of the
 * true one that it is compared with.
 */
function drawnRollouts(data) {
  const keys = [...new Set(data.traces.map(curveKey))];
  const found = keys.map((key) => {
    const trace = data.traces.find((each) => curveKey(each) === key);
    return { key, variant: trace.variant, label: trace.label, robustness: null, seed: null, replicate: null, t: [], margin: [], moment: null, columns: [], ...data.drawn.find((each) => each.id === key) };
  });
  const both = new Set(found.map((each) => each.variant)).size > 1;
  const tested = found.filter((each) => !both || each.variant === "true").sort((a, b) => (a.robustness ?? 0) - (b.robustness ?? 0));
  const colour = (place) => (place >= 0 && place < CURVE_COLOURS ? `c${place}` : "ink");
  return found.map((each) => {
    const compared = both && each.variant === "nominal";
    const pairs = found.filter((other) => other.variant === "nominal").length > 1;
    const place = compared ? (pairs ? tested.findIndex((other) => other.replicate === each.replicate) : -1) : tested.indexOf(each);
    const worst = tested[0] === each;
    return { ...each, colour: colour(place), worst, worstOf: worst ? tested.length : 0, dash: compared ? [8, 5] : place >= 2 ? [2, 3] : [], width: worst ? WORST_WIDTH : compared ? 2 : 1.5 };
  });
}

/** Columns with their curves and limits: those of the specification, then the further ones that the reader wants. */
function columnsOf(data) {
  const traces = [...data.traces, ...data.further.filter((each) => curveView.columns.has(each.column))];
  const names = [...new Set(traces.map((each) => each.column))];
  return names.map((name) => {
    const own = traces.filter((each) => each.column === name);
    return { name, unit: own[0].unit, traces: own, limits: data.limits.filter((_, k) => (data.limit_columns[k] ?? names[0]) === name) };
  });
}

/** The rollouts of the test that a page shows first, where it has them. */
function worstScene(report) {
  const first = report.counterexample ?? rankedOf(report)[0];
  return first && report.scenes.find((each) => each.problem === first.problem && each.test === first.test);
}

/** The column of a picture that has room for one: with a limit, where the specification has one. */
function limitedColumn(data) {
  const columns = columnsOf(data);
  return columns.find((each) => each.limits.length) ?? columns[0];
}

/** Whether the reader wants a further column whose curves are not here; a live page requests them. */
function lacksColumns(data) {
  return data.further.length === 0 && data.further_columns.some((name) => curveView.columns.has(name));
}

/** The controls and charts of a test. */
function curveFigures(report, data) {
  const rollouts = drawnRollouts(data);
  return [
    curveControls(data, rollouts),
    columnsOf(data).map((column, k) =>
      chartFigure(
        `curves-${k}`,
        `${withUnit(column.name, column.unit)} against time`,
        el(`p.readout#read-curves-${k}`, { "data-keep": true }, "Point at a curve to read its values."),
        column.limits.length ? el("ul.legend", limitKey(column)) : null,
      ),
    ),
    data.margin_of ? marginFigure(report, data, rollouts) : null,
  ];
}

function curveControls(data, rollouts) {
  return el(
    "div.curve-controls",
    el("p.muted.drawn", drawnText(data, rollouts), el("span.hint", " Press a rollout to switch its curves off.")),
    el("div.rollout-keys", { role: "group", "aria-label": "Rollouts with curves" }, rollouts.map(rolloutKey)),
    el("p.readout#read-rollout", { "data-keep": true, "aria-live": "polite" }),
    el(
      "div.curve-tools",
      el("span.muted", "Time:"),
      el("span.switch.zoom", { role: "group", "aria-label": "Range of time" }, ZOOMS.map(([what, text, name]) => el("button", { "data-zoom": what, title: name, "aria-label": name, disabled: what !== "in" && curveView.range === null }, text))),
      el("span.muted.hint", "or drag over a chart; double-click: whole time"),
      columnChoice(data),
    ),
  );
}

/** "the worst 3 of 8 nominal rollouts": how many have curves. */
function drawnText(data, rollouts) {
  const parts = ["true", "nominal"].map((variant) => {
    const drawn = rollouts.filter((each) => each.variant === variant && each.id).length;
    const all = data.rollouts.filter((each) => each.variant === variant).length;
    if (drawn === 0) return "";
    return drawn < all ? `${drawn} of ${plural(all, `${variant} rollout`)}` : plural(drawn, `${variant} rollout`);
  });
  return `Curves: ${parts.filter(Boolean).join(", ") || plural(rollouts.length, "rollout")}${rollouts.some((each) => each.worstOf > 1) ? ", the worst in a thick line" : ""}.`;
}

function rolloutKey(rollout) {
  const name = rollout.id ? `${rollout.variant}, replicate ${rollout.replicate}` : short(rollout.label, 60);
  const value = rollout.robustness === null ? "" : `: ${num(rollout.robustness)}`;
  const shown = !curveView.hidden.has(rollout.key);
  return el(
    "button.rollout-key",
    { "data-curve": rollout.key, "aria-pressed": String(shown), title: rollout.id ? `${short(rollout.id)}, seed ${rollout.seed}` : null },
    rolloutLine(rollout),
    `${name}${value}${rollout.worstOf > 1 && rollout.robustness !== null ? " (the worst)" : ""}`,
  );
}

/** The line of a rollout in a legend. */
function rolloutLine({ colour, worst, dash }) {
  const kind = !dash.length ? "" : dash[0] > dash[1] ? ".dashed" : ".dotted";
  return el(`span.key.${colour}${worst ? ".thick" : ""}${kind}`);
}

function columnChoice(data) {
  const names = data.further_columns;
  if (!names.length) return null;
  const missing = data.further.length === 0 && page.live === null;
  const more = data.more_columns ? el("span.muted", ` and ${plural(data.more_columns, "column")} more in the files`) : null;
  if (missing) return el("p.muted.choice", `${plural(names.length + data.more_columns, "further column")} of this test: in its files, and on the live page (perfbound web).`);
  const buttons = names.map((name) => el("button", { "data-column": name, "aria-pressed": String(curveView.columns.has(name)) }, nameElement(name, 30)));
  return el("div.choice", { role: "group", "aria-label": "Further columns" }, el("span.muted", "Further columns:"), buttons, more);
}

function marginFigure(report, data, rollouts) {
  const ends = extent(...rollouts.map((each) => each.margin));
  const clipped = report.clip !== null && ends !== null && (ends[0] < report.clip[0] || ends[1] > report.clip[1]);
  const clip = clipped ? ` The campaign clips it to ${num(report.clip[0])} to ${quantity(report.clip[1], data.margin_unit)}.` : "";
  const none = rollouts.some((each) => each.worst && each.margin.length && each.moment === null);
  const failed = rollouts.some((each) => each.failed_at !== null) ? " A rollout that ends early violates the specification, as the system declares: its robustness is at most minus the share of the horizon that is missing." : "";
  return chartFigure(
    "curves-margin",
    `Robustness over time${unitText(data.margin_unit) && ` (${unitText(data.margin_unit)})`}`,
    el("p.readout#read-curves-margin", { "data-keep": true }, "Point at a curve to read its values."),
    el(
      "ul.legend",
      legendItem("key.zero-line", "the requirement: 0; below it the specification is violated"),
      rollouts.some((each) => each.moment) ? legendItem("mark.moment", "worst moment: here the robustness is attained; where it lasts, its beginning") : null,
    ),
    el("p.muted", "Shown is ", el("code", short(data.margin_of, 300)), data.attained === "first" ? ". " : " at each moment. ", ATTAINED[data.attained] ?? "", failed, clip, none ? " The worst rollout attains it at separate times, so none is marked." : ""),
  );
}

function limitKey({ limits, unit }) {
  const values = limits.map((value) => num(value)).join(", ");
  return values && legendItem("key.limit", `limit of the specification: ${values} ${unitText(unit)}`);
}

// Drawing -------------------------------------------------------------------------------------------------------------

/** Draw the worst rollout beside the claim: a picture without a choice of the reader. */
function drawWorst(report) {
  const host = document.getElementById("worst-curve");
  const data = host && worstScene(report);
  if (!data?.traces.length) return;
  const column = limitedColumn(data);
  const rollout = drawnRollouts(data).find((each) => each.worst);
  const { t, values } = column.traces.find((each) => curveKey(each) === rollout.key) ?? { t: [], values: [] };
  const [low, high] = extent(values, column.limits) ?? [0, 1];
  const border = 0.08 * (high - low) || 0.5;
  const levels = column.limits.map((value) => ({ value, label: `limit ${quantity(value, column.unit)}`, colour: "ink", dash: [2, 3] }));
  const stop = rollout.moment ? { at: rollout.moment[0], label: `worst moment ${momentText(rollout.moment)}` } : undefined;
  const spec = {
    height: 190, x: "time (s)", y: { label: withUnit(short(column.name, 40), column.unit) }, legend: false,
    series: [{ label: short(rollout.key, 60), colour: "red", width: 2.5 }],
  };
  chart(host, spec, [t, values], undefined, { range: [low - border, high + border], levels, stop });
}

/** Draw the curves of the selected test. */
function drawCurves(data) {
  const rollouts = data ? drawnRollouts(data) : [];
  const present = new Set();
  const put = (id, of) => {
    const host = document.getElementById(id);
    if (host === null) return;
    present.add(id);
    drawCurveChart(host, { ...of, rollouts });
  };
  columnsOf(data ?? { traces: [], further: [], limits: [], limit_columns: [] }).forEach((column, k) => {
    const curve = (rollout) => column.traces.find((each) => curveKey(each) === rollout.key) ?? { t: [], values: [] };
    put(`curves-${k}`, { name: short(column.name, 40), label: withUnit(column.name, column.unit), unit: column.unit, curve, limits: column.limits, height: 250, marks: (rollout) => rollout.columns.includes(column.name) });
  });
  if (data?.margin_of) {
    put("curves-margin", { name: "robustness", label: withUnit("robustness", data.margin_unit), unit: data.margin_unit, curve: (rollout) => ({ t: rollout.t, values: rollout.margin }), limits: [], zero: true, height: 210, marks: () => true });
  }
  for (const id of curvePlots.keys()) if (!present.has(id)) curvePlots.delete(id);
  (data?.inputs ?? []).forEach((input, k) => {
    const host = document.getElementById(`inputs-${k}`);
    if (host) drawInput(host, input);
  });
  showFocus();
}

function drawCurveChart(host, of) {
  const colours = curveColours();
  const curves = of.rollouts.map((rollout) => of.curve(rollout));
  const times = [...new Set(curves.flatMap((each) => each.t))].sort((a, b) => a - b);
  const table = [times, ...curves.map((each) => valuesAt(each, times))];
  const spec = {
    height: of.height, x: "time (s)", y: { label: of.label }, legend: false,
    series: of.rollouts.map(({ key, colour, width, dash }) => ({ label: short(key, 60), colour, width, dash })),
  };
  const key = JSON.stringify([spec, of.limits, colours.paper]);
  const present = charts.get(host);
  if (present?.key === key) {
    curvePlots.get(host.id).of = of;
    present.plot.setData(table, false);
    present.plot.redraw();
  } else {
    present?.plot.destroy();
    const state = { plot: null, of };
    curvePlots.set(host.id, state);
    state.plot = new uPlot(curveOptions(host, spec, colours, state), table, host);
    charts.set(host, { plot: state.plot, key });
  }
  const { plot } = curvePlots.get(host.id);
  of.rollouts.forEach((rollout, k) => {
    const shown = !curveView.hidden.has(rollout.key);
    if (plot.series[k + 1].show !== shown) plot.setSeries(k + 1, { show: shown });
  });
  applyRange(plot, of);
}

function curveColours() {
  const styles = getComputedStyle(document.documentElement);
  const onPage = printing || onPaper.matches;
  const own = ["c0", "c1", "c2", "c3", "bad-line"].map((name) => [name, styles.getPropertyValue(`--${onPage ? "paper-" : ""}${name}`).trim() || styles.getPropertyValue(`--${name}`).trim()]);
  return { ...theme(), ...Object.fromEntries(own) };
}

function curveOptions(host, spec, colours, state) {
  const options = chartOptions(host, spec, colours);
  return {
    ...options,
    padding: [20, 14, 0, 0], // the time of the worst moment is above the curves
    cursor: { ...options.cursor, drag: { x: true, y: false, setScale: true, dist: 4 }, focus: { prox: 24 }, sync: { key: "curves", setSeries: true, scales: ["x", null] } },
    focus: { alpha: 0.25 },
    scales: { x: { time: false }, y: { range: () => valueRange(state.of) } },
    hooks: {
      setCursor: [(plot) => readCurves(plot, host.id, state.of)],
      setSeries: [(plot, k, change) => "focus" in change && focusRollout(k === null || k === undefined ? null : state.of.rollouts[k - 1]?.key ?? null)],
      setScale: [(plot, name) => name === "x" && state.plot !== null && takeRange(plot)],
      drawClear: [(plot) => drawBackground(plot, state.of, colours)],
      draw: [(plot) => drawForeground(plot, state.of, colours)],
    },
  };
}

/** The range of the values in sight, of the limits and of the requirement; a curve may have no sample in sight. */
function valueRange(of) {
  const [from, to] = curveView.range ?? [-Infinity, Infinity];
  const seen = of.rollouts.filter((each) => !curveView.hidden.has(each.key)).map((each) => {
    const { t, values } = of.curve(each);
    return [...values.filter((_, k) => t[k] >= from && t[k] <= to), ...valuesAt({ t, values }, [from, to])];
  });
  const ends = extent(...seen, of.limits, of.zero ? [0] : []) ?? [0, 1];
  const border = 0.08 * (ends[1] - ends[0]) || 0.5;
  return [ends[0] - border, ends[1] + border];
}

/** Values of a curve at increasing times, linear between its samples; null outside of them. */
function valuesAt({ t, values }, times) {
  let k = 0;
  return times.map((time) => {
    while (k < t.length && t[k] < time) k += 1;
    if (k === t.length || time < t[0]) return null; // also of a curve without samples
    if (t[k] === time || k === 0) return values[k];
    return values[k - 1] + ((time - t[k - 1]) / (t[k] - t[k - 1])) * (values[k] - values[k - 1]);
  });
}

/** The part below the requirement, and the stretch in which the worst rollout attains its robustness. */
function drawBackground(plot, of, colours) {
  const { ctx, bbox } = plot;
  ctx.save();
  if (of.zero) {
    const y = Math.max(bbox.top, Math.min(plot.valToPos(0, "y", true), bbox.top + bbox.height));
    ctx.globalAlpha = 0.1;
    ctx.fillStyle = colours["bad-line"];
    ctx.fillRect(bbox.left, y, bbox.width, bbox.top + bbox.height - y);
  }
  const worst = of.rollouts.find((each) => each.worst && each.moment);
  if (worst && !curveView.hidden.has(worst.key) && worst.moment[1] > worst.moment[0]) {
    const [from, to] = worst.moment.map((t) => Math.max(bbox.left, Math.min(plot.valToPos(t, "x", true), bbox.left + bbox.width)));
    ctx.globalAlpha = 0.1;
    ctx.fillStyle = colours.muted;
    ctx.fillRect(from, bbox.top, to - from, bbox.height);
  }
  ctx.restore();
}

/** Limits, the requirement, and the worst moment of each rollout, that of the worst with its time. */
function drawForeground(plot, of, colours) {
  const { ctx, bbox } = plot;
  const ratio = uPlot.pxRatio;
  ctx.save();
  ctx.lineWidth = 1.5 * ratio;
  for (const [value, colour, dash] of [...of.limits.map((each) => [each, "ink", [2, 3]]), ...(of.zero ? [[0, "bad-line", []]] : [])]) {
    ctx.strokeStyle = colours[colour];
    ctx.setLineDash(dash.map((each) => each * ratio));
    const y = plot.valToPos(value, "y", true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.setLineDash([]);
  const marked = of.rollouts.filter((each) => each.moment && !curveView.hidden.has(each.key)).sort((a, b) => a.worst - b.worst);
  for (const rollout of marked) drawMoment(plot, of, rollout, colours);
  ctx.restore();
}

function drawMoment(plot, of, rollout, colours) {
  const { ctx, bbox } = plot;
  const ratio = uPlot.pxRatio;
  const x = plot.valToPos(rollout.moment[0], "x", true);
  if (x < bbox.left - 1 || x > bbox.left + bbox.width + 1) return;
  if (rollout.worst) {
    ctx.strokeStyle = colours.muted;
    ctx.setLineDash([4 * ratio, 3 * ratio]);
    ctx.lineWidth = ratio;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.font = `${12 * ratio}px system-ui, sans-serif`;
    ctx.fillStyle = colours.ink;
    ctx.textAlign = "left";
    const text = `worst moment ${momentText(rollout.moment)}`;
    ctx.fillText(text, Math.min(x - 4 * ratio, bbox.left + bbox.width - ctx.measureText(text).width), bbox.top - 6 * ratio);
  }
  const [value] = valuesAt(of.curve(rollout), [rollout.moment[0]]);
  if (!of.marks(rollout) || value === null || value === undefined) return;
  ctx.beginPath();
  ctx.arc(x, plot.valToPos(value, "y", true), (rollout.worst ? 5.5 : 3.5) * ratio, 0, 2 * Math.PI);
  ctx.fillStyle = colours[rollout.colour];
  ctx.strokeStyle = colours.paper;
  ctx.lineWidth = 1.5 * ratio;
  ctx.fill();
  ctx.stroke();
}

/** "4.95 s", or "4.95 s to 8 s". */
function momentText([from, to]) {
  return from === to ? `${num(from)} s` : `${num(from)} s to ${num(to)} s`;
}

/** Write the values at the pointer: that of the highlighted rollout, or the range of each variant. */
function readCurves(plot, id, of) {
  const output = document.getElementById(`read-${id}`);
  if (output === null || !(plot.cursor.left >= 0)) return;
  const t = plot.posToVal(plot.cursor.left, "x");
  const shown = of.rollouts.filter((each) => !curveView.hidden.has(each.key));
  const value = (rollout) => valuesAt(of.curve(rollout), [t])[0];
  const focused = shown.find((each) => each.key === curveView.focused);
  if (focused) {
    output.textContent = `t = ${num(t, 3)} s: ${of.name} ${quantity(value(focused) ?? null, of.unit)} of ${identityText(focused)}`;
    return;
  }
  const values = ["true", "nominal"].map((variant) => {
    const range = extent(shown.filter((each) => each.variant === variant).map(value));
    if (range === null) return "";
    const [low, high] = range;
    return `${variant} ${low === high ? "" : `${num(low)} to `}${quantity(high, of.unit)}`;
  });
  output.textContent = `t = ${num(t, 3)} s: ${values.filter(Boolean).join(", ")}`;
}

/** "sim_gap.3.true.0, seed 7, robustness -3.66": what tells a rollout from all others. */
function identityText(rollout) {
  if (!rollout.id) return short(rollout.label, 200);
  const robustness = rollout.robustness === null ? "" : `, robustness ${num(rollout.robustness)}`;
  const moment = rollout.moment === null ? "" : `, worst moment ${momentText(rollout.moment)}`;
  return `${short(rollout.id)}, seed ${rollout.seed}${robustness}${moment}`;
}

// Input of the reader -------------------------------------------------------------------------------------------------

/** Highlight a rollout in all charts; null: none. */
function focusRollout(key) {
  if (key === curveView.focused) return;
  curveView.focused = key;
  showFocus();
}

function showFocus() {
  let text = "";
  for (const [id, { plot, of }] of curvePlots) {
    const k = of.rollouts.findIndex((each) => each.key === curveView.focused);
    if (k >= 0) text = identityText(of.rollouts[k]);
    plot.setSeries(k < 0 ? null : k + 1, { focus: k >= 0 }, false);
    readCurves(plot, id, of);
  }
  const output = document.getElementById("read-rollout");
  if (output) output.textContent = text;
  for (const button of document.querySelectorAll("[data-curve]")) button.classList.toggle("focused", curveView.focused !== null && button.dataset.curve === curveView.focused);
}

/** Take the range of time of a chart over to the others. */
function takeRange(plot) {
  const { min, max } = plot.scales.x;
  const whole = extent(plot.data[0]);
  if (whole === null || min === null) return;
  const slack = 1e-9 * (whole[1] - whole[0]);
  setRange(min <= whole[0] + slack && max >= whole[1] - slack ? null : [min, max]);
}

function setRange(range) {
  if (String(range) === String(curveView.range)) return;
  curveView.range = range;
  for (const { plot, of } of curvePlots.values()) if (plot !== null) applyRange(plot, of);
  for (const button of document.querySelectorAll("[data-zoom]:not([data-zoom=in])")) button.disabled = range === null;
}

function applyRange(plot, of) {
  const [min, max] = curveView.range ?? extent(plot.data[0]) ?? [0, 1];
  const [low, high] = valueRange(of);
  plot.batch(() => {
    if (plot.scales.x.min !== min || plot.scales.x.max !== max) plot.setScale("x", { min, max });
    if (plot.scales.y.min !== low || plot.scales.y.max !== high) plot.setScale("y", { min: low, max: high });
  });
}

/** Zoom about the worst moment if it is in sight, else about the middle; or move by half of what is in sight. */
function zoom(what) {
  const [state] = curvePlots.values();
  const whole = state && extent(state.plot.data[0]);
  if (!whole) return;
  const [from, to] = curveView.range ?? whole;
  const moment = state.of.rollouts.find((each) => each.worst)?.moment?.[0];
  let [low, high] = [from, to];
  if (what === "whole") [low, high] = whole;
  else if (what in TIMES) {
    const middle = what === "in" && moment >= from && moment <= to ? moment : (from + to) / 2;
    const half = (TIMES[what] * (to - from)) / 2;
    [low, high] = [middle - half, middle + half];
  } else {
    const step = ((what === "later" ? 1 : -1) * (to - from)) / 2;
    const move = Math.max(whole[0] - from, Math.min(step, whole[1] - to));
    [low, high] = [from + move, to + move];
  }
  [low, high] = [Math.max(low, whole[0]), Math.min(high, whole[1])];
  setRange(low <= whole[0] && high >= whole[1] ? null : [low, high]);
}

function onCurveClick(event) {
  const target = event.target.closest("[data-curve], [data-zoom], [data-column]");
  if (target === null) return;
  if (target.dataset.zoom !== undefined) zoom(target.dataset.zoom);
  else {
    const [chosen, name] = target.dataset.column !== undefined ? [curveView.columns, target.dataset.column] : [curveView.hidden, target.dataset.curve];
    if (!chosen.delete(name)) chosen.add(name);
    draw();
  }
}

function onCurvePointer({ target, type }) {
  const button = target.closest?.("[data-curve]");
  if (button) focusRollout(type === "pointerout" || type === "focusout" ? null : button.dataset.curve);
}

document.addEventListener("click", onCurveClick);
for (const type of ["pointerover", "pointerout", "focusin", "focusout"]) document.addEventListener(type, onCurvePointer);

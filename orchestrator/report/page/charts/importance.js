// Importance of each parameter: shares of the variation as bars, and the mean over all other parameters as curves.

const MOST_EFFECTS = 6; // of the most important parameters
const EFFECT = { width: 150, height: 64, margin: 4 }; // of a small curve, in units of its picture

function importanceFigure(report, problem) {
  const { importance } = problem.charts;
  if (importance === null) return null;
  const { parameters, of_model: ofModel } = importance;
  const range = extent(...parameters.map(({ effect }) => effect));
  const low = { name: ofModel ? "posterior mean" : "observed robustness", unit: observedUnit(problem) };
  return el(
    "figure.importance",
    el("figcaption", "Importance of each parameter"),
    el("div.shares", parameters.map((each) => shareRow(report.axes[each.axis], each, importance.chance))),
    el(
      "ul.legend",
      legendItem("key.first", "by itself"),
      ofModel ? legendItem("key.total", "together with the others (interactions)") : null,
      importance.chance === null ? null : legendItem("key.chance", `up to ${percent(importance.chance)} may be chance`),
    ),
    el("div.effects", parameters.slice(0, MOST_EFFECTS).map((each) => effectCurve(report.axes[each.axis], each, range, low))),
    caption(importanceCaption(report, problem)),
  );
}

function importanceCaption(report, { charts: { importance }, observed, unit, drawn }) {
  const most = importance.parameters.length > MOST_EFFECTS ? ` of the ${MOST_EFFECTS} most important` : "";
  const left = readAxes(report).length - importance.parameters.length;
  const others = left > 0 ? ` The ${left} least important parameters are left out.` : "";
  if (importance.of_model) {
    return `Bars: the share of the variation of the model's mean over the box that a parameter explains (first-order and total Sobol indices, exact on the ${count(importance.values)} nodes of a grid, every start as likely as another). Curves${most}: the mean of the model over all other parameters. This describes the model after ${plural(observed, "test")}, and is no part of the claim.${others}`;
  }
  return `Bars: the share of the variation of the observed robustness at ${count(importance.values)} drawn starts that a parameter explains by itself (first-order Sobol indices, estimated by ranks). Curves${most}: means of neighbouring tests${unitText(drawn?.unit ?? unit) && ` in ${unitText(drawn?.unit ?? unit)}`}. This describes the tests, and is no part of the claim.${others}`;
}

function percent(share) {
  return `${num(100 * share, 2)} %`;
}

/** Name, bar and share of one parameter, with more text behind it. */
function shareRow(axis, { first, total }, chance, more = "") {
  const at = (share) => 1000 * Math.min(1, share);
  const bars = [svg("rect", { class: "first", x: 0, y: 3, width: Math.max(2, at(first)), height: 12 })];
  if (total !== null) bars.unshift(svg("rect", { class: "total", x: 0, y: 3, width: Math.max(2, at(total)), height: 12 }));
  if (chance !== null) bars.push(svg("line", { class: "chance", x1: at(chance), x2: at(chance), y1: 0, y2: 18 }));
  const alone = total === null || percent(total) === percent(first);
  const text = alone ? percent(first) : `${percent(first)}; ${percent(total)} with the others`;
  return [
    el("span", { title: visible(axis.name).slice(0, 1000) }, shortMiddle(axis.name, 30)),
    svg("svg", { viewBox: "0 0 1000 18", preserveAspectRatio: "none", "aria-hidden": "true" }, ...bars),
    el("span.value", text + more),
  ];
}

/** The mean over all others as a curve over one parameter; `range` is common to all of them. */
function effectCurve(axis, { at, effect }, range, { name, unit, digits = 4 }) {
  const { width, height, margin } = EFFECT;
  const picture = { left: margin, top: margin, width: width - 2 * margin, height: height - 2 * margin };
  const { toX, toY } = frame(picture, [axis.low, axis.high], range);
  const points = at.map((value, k) => `${toX(value).toFixed(2)},${toY(effect[k]).toFixed(2)}`).join(" ");
  const ends = extent(effect);
  const label = `${name} against ${withUnit(axis.name, axis.unit)}: from ${num(effect[0])} to ${quantity(effect.at(-1), unit)}`;
  return el(
    "div.effect",
    el("div.muted", { title: visible(axis.name).slice(0, 1000) }, withUnit(shortMiddle(axis.name, 20), axis.unit)),
    svg("svg", { viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", role: "img", "aria-label": label }, svg("polyline", { points })),
    el("div.ends", el("span", num(axis.low, digits)), el("span", `${num(ends[0], digits)} to ${quantity(ends[1], unit, digits)}`), el("span", num(axis.high, digits))),
  );
}

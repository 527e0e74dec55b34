// What the declared disturbances do: the share of each with its curve, and the rollouts by the two that matter most.

function disturbanceFigure(report, problem) {
  const found = problem.charts.disturbances;
  if (found === null) return null;
  const { shares, chance, explained } = found;
  const axisOf = ({ place, at }) => ({ ...report.disturbances[place], low: at[0], high: at.at(-1) });
  const unit = explained === null ? found.unit : problem.unit;
  const value = { name: explained === null ? "observed robustness" : "part of the control", unit, digits: 3 };
  const range = extent(...shares.map(({ effect }) => effect));
  const row = (each) => shareRow(axisOf(each), { first: each.share, total: null }, chance, each.deviation === null ? "" : `, sd ${quantity(each.deviation, unit, 3)}`);
  return el(
    "figure.importance.sensitivity",
    el("figcaption", "Sensitivity to each disturbance"),
    el("div.shares", shares.map(row)),
    chance === null ? null : el("ul.legend", legendItem("key.first", "by itself"), legendItem("key.chance", `up to ${percent(chance)} may be chance`)),
    el("div.effects", shares.slice(0, MOST_EFFECTS).map((each) => effectCurve(axisOf(each), each, range, value))),
    caption(sensitivityCaption(report, problem)),
  );
}

function sensitivityCaption(report, problem) {
  const { shares, explained, left, sampled, before_fit: before, unit } = problem.charts.disturbances;
  const most = shares.length > MOST_EFFECTS ? ` of the first ${MOST_EFFECTS}` : "";
  const others = report.disturbances.length - shares.length;
  const rest = others > 0 ? ` ${plural(others, "disturbance")} with less are left out.` : "";
  if (explained === null) {
    return `Bars: the share of the variation of the robustness of ${plural(sampled, "rollout")} that a disturbance explains by itself (adjusted R\u00b2 of the means of rollouts with neighbouring values). Curves${most}: these means${unitText(unit) && ` in ${unitText(unit)}`}. This describes the rollouts, and is no part of the claim.${rest}`;
  }
  return `Bars: the share of the variance of a rollout that the control takes out for a disturbance, over all starts, and the standard deviation of that. Curves${most}: what it takes out${unitText(problem.unit) && ` in ${unitText(problem.unit)}`} in the middle of the starts, up to 3 standard deviations on either side. Together it is ${num(100 * explained, 3)} % of the variance; a standard deviation of ${quantity(left, problem.unit, 3)} is left. The control comes from the tests before, after the first ${plural(before, "rollout")}; the bound is valid whatever it is, if the disturbances have their laws.${rest}`;
}

function disturbedFigure(report, problem, index) {
  const scatter = problem.charts.disturbances?.scatter ?? null;
  if (scatter === null) return null;
  const title = "Rollouts by their disturbances";
  const text = disturbedCaption(report, problem);
  const [worst, middle, best] = scatterValues(scatter);
  const { unit } = problem.charts.disturbances;
  return el(
    "figure.disturbed",
    el("figcaption", title),
    el(`canvas#disturbed-${index}`, { "data-keep": true, role: "img", "aria-label": `${title}: ${text}` }),
    el(
      "ul.legend",
      legendItem("mark.missed", scatter.violations ? "violates the specification" : "worst rollouts"),
      el("li", el("span.ramp"), `robustness: ${num(worst)} (worst), ${num(middle)} (middle), ${quantity(best, unit)} (best)`),
    ),
    worstDisturbed(report, problem),
    caption(text),
  );
}

function disturbedCaption(report, problem) {
  const { axes, at, marked, rollouts, violations } = problem.charts.disturbances.scatter;
  const names = axes.map((k) => short(report.disturbances[k].name, 40));
  const where = names.length > 1 ? `its ${names.join(" and ")}, the two disturbances that matter most` : `its ${names[0]} and its robustness`;
  const crosses = violations
    ? `The crosses are rollouts that violate the specification, as ${count(violations)} of ${count(rollouts)} do.`
    : `The crosses are the ${count(marked.filter(Boolean).length)} worst of ${plural(rollouts, "rollout")}, none of which violates the specification.`;
  const drawn = at[0].length < rollouts ? ` The picture has ${count(at[0].length)} of them: the worst ones, and an even choice of the others.` : "";
  return `Each dot is a rollout, by ${where}; the stronger its colour the worse its robustness, with half of the dots on either side of the middle. ${crosses}${drawn}`;
}

/** "Worst rollout true_risk.3.true.1, robustness 0.18 rad: gust = 5.8 m/s (2.9 sd)", as a button. */
function worstDisturbed(report, problem) {
  const { worst, unit } = problem.charts.disturbances;
  if (worst === null) return null;
  return el(
    "p",
    "Worst rollout ",
    el("button", { "data-select": `${problem.name}:${worst.test}` }, short(worst.id)),
    ", robustness ",
    el(worst.robustness < 0 ? "strong.bad" : "strong", quantity(worst.robustness, unit)),
    `: ${disturbanceText(report, worst.disturbances)}.`,
  );
}

/** "gust = 5.8 m/s (2.9 sd), mass = 1.01 kg (0.2 sd), and 3 more", those furthest out first. */
function disturbanceText(report, drawn) {
  const far = ({ sd, chance }) => (sd === null ? `probability ${num(chance, 3)}` : `${sd.toFixed(1)} sd`);
  const one = (each) => `${shortMiddle(report.disturbances[each.place].name, 24)} = ${quantity(each.value, report.disturbances[each.place].unit, 3)} (${far(each)})`;
  const more = report.disturbances.length - drawn.length;
  return drawn.map(one).join(", ") + (more > 0 ? `, and ${count(more)} more` : "");
}

/** The worst, the middle and the best robustness in the picture. */
function scatterValues({ margin }) {
  const sorted = [...margin].sort((a, b) => a - b);
  return [sorted[0], sorted[(sorted.length - 1) >> 1], sorted.at(-1)];
}

/** Draw the rollouts over the width of their canvas, the worst ones on top. */
function drawDisturbed(report, problem, index) {
  const canvas = document.getElementById(`disturbed-${index}`);
  const found = problem.charts.disturbances;
  if (canvas === null || canvas.clientWidth === 0) return;
  const { axes, at, margin, marked } = found.scatter;
  const width = canvas.clientWidth;
  const box = { left: MARGIN.left + 10, top: 14, width: Math.max(80, width - MARGIN.left - 10 - MARGIN.right) };
  box.height = Math.min(box.width * 0.75, 340);
  const [x, y] = [at[0], at[1] ?? margin];
  const view = frame(box, widened(extent(x)), widened(extent(y)));
  const context = canvasContext(canvas, width, box.top + box.height + MARGIN.bottom);
  const name = (k) => withUnit(report.disturbances[k].name, report.disturbances[k].unit);
  drawScatterAxes(context, view, [name(axes[0]), axes.length > 1 ? name(axes[1]) : withUnit("robustness", found.unit)]);
  const colours = theme();
  const colour = rampColour(scatterValues(found.scatter));
  const many = margin.length > MANY_DOTS;
  const order = margin.map((_, k) => k).sort((a, b) => marked[a] - marked[b] || margin[b] - margin[a]);
  for (const k of order) {
    const place = [view.toX(x[k]), view.toY(y[k])];
    if (marked[k]) cross(context, place, 4, colours.red);
    else disc(context, place, many ? 2 : 2.8, colour(margin[k]), colours.paper, 0.4);
  }
  Object.assign(canvas.dataset, { rollouts: margin.length, marked: marked.filter(Boolean).length });
}

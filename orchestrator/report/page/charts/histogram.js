// Histograms of the robustness, violations in red: at drawn starts with the bounds as lines across it, and of all rollouts.

const SIGN = { ">=": "\u2265", "<=": "\u2264" };

function histogramFigure(drawn, id) {
  const beyond = (value) => (value < drawn.edges[0] || value > drawn.edges.at(-1) ? ", beyond the axis" : "");
  const marks = drawn.marks.map(({ name, value, sense }, k) =>
    el("li", el("b", `${letter(k)} `), el("span.muted", `${short(name, 60)} `), `${sentence(SIGN[sense])} ${boundText(value, sense, drawn.unit)}${beyond(value)}`));
  return el(
    "figure.histogram",
    chartFigure(id, "Robustness of the rollouts at drawn starts"),
    el("ul.legend", legendItem("key.violations", "violates the specification"), legendItem("key.kept", "meets it")),
    marks.length ? el("ul.marks", marks) : null,
    caption(drawnCaption(drawn)),
  );
}

function drawnCaption(drawn) {
  const lines = drawn.marks.length ? " The lines with letters are the claimed bounds of the list." : "";
  const number = samplesOf({ drawn });
  return `How often each robustness occurred in the first rollouts at ${count(number)} drawn starts: ${count(drawn.violations)} of them, red, violate${drawn.violations === 1 ? "s" : ""} the specification; the worst is ${quantity(drawn.least, drawn.unit)}, of test ${count(drawn.worst)}.${lines}`;
}

/** Histograms of the robustness of all rollouts of a problem, one for each variant, over one axis. */
function rolloutFigure(problem, index) {
  const { rollouts } = problem.charts;
  if (rollouts === null) return null;
  const one = rollouts.variants.length === 1;
  return el(
    "figure.histogram",
    el("figcaption", "Robustness of the rollouts behind the bound"),
    rollouts.variants.map((each) => el("div", one ? null : el("h3", `${words(each.variant)} system`), el(`div.chart#rollouts-${index}-${each.variant === "true" ? "true" : "nominal"}`, { "data-keep": true, role: "img", "aria-label": variantCaption(each, rollouts, problem) }))),
    el("ul.legend", legendItem("key.violations", "violates the specification"), legendItem("key.kept", "meets it")),
    rollouts.variants.map((each) => caption(variantCaption(each, rollouts, problem))),
  );
}

function variantCaption({ variant, rollouts, violations, least, test, at_clip: [low, high] }, { unit }, problem) {
  const worst = `the worst is ${quantity(least, unit)}${low ? " or lower, which the clip hides" : ""}, of test ${count(test)}`;
  const clipped = high ? ` ${count(high)} are at the upper end of the clip, or beyond it.` : "";
  const tested = problem.sense === "max" ? "" : " The method chose the starts, so this is no sample of all of them.";
  return `${words(variant)[0].toUpperCase()}${words(variant).slice(1)} system: how often each robustness occurred in ${plural(rollouts, "rollout")}; ${violations ? count(violations) : "none"} of them violate${violations > 1 ? "" : "s"} the specification, and ${worst}.${clipped}${tested}`;
}

function drawRolloutHistograms(problem, index) {
  const { rollouts, required } = problem.charts;
  for (const { variant, counts, least } of rollouts?.variants ?? []) {
    const host = document.getElementById(`rollouts-${index}-${variant === "true" ? "true" : "nominal"}`);
    const lines = [{ value: least, colour: "ink", label: "worst" }];
    if (required) lines.push({ value: required, colour: "ink", label: "required" });
    drawBars(host, { ...rollouts, counts }, lines, rollouts.variants.length > 1 ? 150 : 190);
  }
}

/** Name of a line in its histogram. */
function letter(k) {
  return String.fromCharCode(97 + (k % 26));
}

function drawHistogram(drawn, id) {
  drawBars(document.getElementById(id), drawn, drawn.marks.map(({ value }, k) => ({ value, colour: "ink", label: letter(k) })), 230);
}

/** Draw counts between edges as bars, those below 0 red, with upright lines. */
function drawBars(host, { edges, counts, unit }, lines, height) {
  const centres = counts.map((_, k) => (edges[k] + edges[k + 1]) / 2);
  const bars = (violates) => counts.map((each, k) => (each > 0 && violates === edges[k + 1] <= 0 ? each : null));
  chart(
    host,
    {
      height, x: withUnit("robustness", unit), y: { label: "rollouts", fromZero: true }, legend: false,
      range: [edges[0], edges.at(-1)],
      lines: [...lines, { value: 0, colour: "red" }],
      series: [
        { label: "violations", colour: "red", bars: true },
        { label: "others", colour: "blue", bars: true },
      ],
    },
    [centres, bars(true), bars(false)],
  );
}

/** Number of the tests whose starts were drawn; a search proposes others. */
function samplesOf({ drawn }) {
  return drawn.counts.reduce((sum, each) => sum + each, 0);
}

/** One row for each requirement: how often it was violated, what is claimed, and its worst test as a button. */
function requirementTable(problem) {
  if (!problem.requirements.length) return null;
  const samples = samplesOf(problem);
  const bounded = problem.requirements.some(({ marks }) => marks.length > 0);
  const row = (each) => {
    const id = `${problem.name}:${each.worst}`;
    return el(
      "tr",
      el("th", { scope: "row" }, nameElement(each.requirement, 40)),
      el("td", `${count(each.violations)} of ${count(samples)}`),
      el("td", each.failure === null ? null : `${SIGN["<="]} ${boundText(each.failure, "<=", "")}`),
      bounded ? el("td", each.marks.map(({ name, value, sense }) => el("div", `${short(name, 60)} ${SIGN[sense]} ${boundText(value, sense, each.unit)}`))) : null,
      el("td", el("button", { "data-test": id, "data-select": id }, quantity(each.least, each.unit))),
    );
  };
  const heads = ["Requirement", "Violated", "Probability of a violation", ...(bounded ? ["Robustness"] : []), "Worst test"];
  return el(
    "figure.requirements",
    el("figcaption", "Requirements, each with its own claim"),
    el("table", el("thead", el("tr", heads.map((head) => el("th", { scope: "col" }, head)))), el("tbody", problem.requirements.map(row))),
  );
}

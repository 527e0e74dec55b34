// Histogram of the robustness at drawn starts: violations in red, and the bounds as lines across it.

const SIGN = { ">=": "\u2265", "<=": "\u2264" };

function histogramFigure(problem, index) {
  const { drawn } = problem;
  const marks = drawn.marks.map(({ name, value, sense }, k) =>
    el("li", el("b", `${letter(k)} `), el("span.muted", `${short(name, 60)} `), `${sentence(SIGN[sense])} ${boundText(value, sense, drawn.unit)}`));
  return el(
    "figure.histogram",
    chartFigure(`histogram-${index}`, "Robustness of the rollouts at drawn starts"),
    el("ul.legend", legendItem("key.violations", "violates the specification"), legendItem("key.kept", "meets it")),
    marks.length ? el("ul.marks", marks) : null,
  );
}

/** Name of a line in its histogram. */
function letter(k) {
  return String.fromCharCode(97 + (k % 26));
}

function drawHistogram(problem, index) {
  const { edges, counts, unit, marks } = problem.drawn;
  const centres = counts.map((_, k) => (edges[k] + edges[k + 1]) / 2);
  const bars = (violates) => counts.map((each, k) => (each > 0 && violates === edges[k + 1] <= 0 ? each : null));
  chart(
    document.getElementById(`histogram-${index}`),
    {
      height: 230, x: withUnit("robustness", unit), y: { label: "rollouts", fromZero: true }, legend: false,
      range: [edges[0], edges.at(-1)],
      lines: [...marks.map(({ value }, k) => ({ value, colour: "ink", label: letter(k) })), { value: 0, colour: "red" }],
      series: [
        { label: "violations", colour: "red", bars: true },
        { label: "others", colour: "blue", bars: true },
      ],
    },
    [centres, bars(true), bars(false)],
  );
}

// Histogram of the robustness at drawn starts: violations in red, and the bounds as lines across it.

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
  );
}

/** Name of a line in its histogram. */
function letter(k) {
  return String.fromCharCode(97 + (k % 26));
}

function drawHistogram(drawn, id) {
  const { edges, counts, unit, marks } = drawn;
  const centres = counts.map((_, k) => (edges[k] + edges[k + 1]) / 2);
  const bars = (violates) => counts.map((each, k) => (each > 0 && violates === edges[k + 1] <= 0 ? each : null));
  chart(
    document.getElementById(id),
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

// Sections of the selected test (curves, rollouts, commands that repeat them) and of the counterexamples.

const VARIANTS = {
  nominal: { colour: "blue", width: 3, dash: [8, 5] },
  true: { colour: "red", width: 1.1 },
};
const INTERPOLATION = { pchip: "joined by monotone cubics", linear: "joined by straight lines", constant: "each held until the next one" };
const FIRST_ROWS = 10;

/**
 * The section of the selected test.
 * @param {{problem: string, test: number}|null} selected
 * @param {object|null|undefined} data rollouts of that test; null: there are none; undefined: being loaded
 */
function testSection(report, selected, data, live) {
  const problem = report.problems.find((each) => each.name === selected?.problem);
  if (!problem) return el("section#test", el("h2", "Trajectories of a test"), el("p.muted", "No test observed yet."));
  const k = problem.tests.test.indexOf(selected.test);
  return el(
    "section#test",
    { "data-problem": selected.problem, "data-test": selected.test, "data-curves": data?.traces.length ?? 0, "aria-busy": String(data === undefined), tabindex: -1 },
    el("h2", `Test ${selected.test} of `, nameElement(words(selected.problem)), el("span.switch", neighbourButton(problem, k, -1), neighbourButton(problem, k, 1), el("a.back", { href: `#problem-${report.problems.indexOf(problem)}` }, "show map"))),
    k < 0 ? null : el("p", testText(report, problem, k)),
    data?.error ? el("p.note.bad", short(data.error, 1000)) : null,
    data?.inputs.length ? inputFigures(data) : null,
    data?.traces.length ? curveFigures(data) : el("p.note", noCurves(selected, data, live)),
    data?.rollouts.length ? rolloutTable(["Variant", "#Replicate"], data.rollouts, (each) => [words(each.variant), each.replicate]) : null,
  );
}

function neighbourButton(problem, k, step) {
  const test = problem.tests.test[k + step];
  const name = step < 0 ? "\u2190 previous test" : "next test \u2192";
  return el("button", { "data-select": `${problem.name}:${test}`, disabled: k < 0 || test === undefined }, name);
}

function testText(report, problem, k) {
  const { x, y, distance } = problem.tests;
  const rank = worstFirst(report, problem).indexOf(k);
  const worst = rank === 0 ? ", the worst of this problem" : "";
  const remaining = distance[k] === null ? "" : `; ${sentence(problem.distance, 20)} = ${quantity(distance[k], problem.unit)}`;
  return `Start ${place(x[k], report.axes)}: observed ${quantity(y[k], observedUnit(problem))}${worst}${remaining}.`;
}

function noCurves(selected, data, live) {
  if (data === undefined) return "Loading the trajectories.";
  if (data) return "No curves: each rollout is a single number, or its file is unreadable.";
  if (live) return "This test has no trajectories yet.";
  return `This report has no curves of this test. Its trajectories are the MCAP files of test ${selected.test} in trajectories/${short(selected.problem)}/.`;
}

/** The columns of the trajectories, each with its curves (nominal ones last, so on top) and its limits. */
function columnsOf(data) {
  const names = [...new Set(data.traces.map((each) => each.column))];
  return names.map((name) => {
    const traces = data.traces.filter((each) => each.column === name);
    const limits = data.limits.filter((_, k) => (data.limit_columns?.[k] ?? names[0]) === name);
    traces.sort((a, b) => (a.variant === "nominal") - (b.variant === "nominal"));
    return { name, unit: traces[0].unit, traces, limits };
  });
}

function curveFigures(data) {
  return columnsOf(data).map((column, k) =>
    chartFigure(
      `curves-${k}`,
      `${withUnit(column.name, column.unit)} against time`,
      el(`p.readout#read-curves-${k}`, { "data-keep": true }, "Point at the curves to read values."),
      el("ul.legend", variantKey(data, column, "nominal"), variantKey(data, column, "true"), limitKey(column)),
    ),
  );
}

/** The input signals of the test's start, one picture each. */
function inputFigures(data) {
  return data.inputs.map(({ name, unit, kind, knots }, k) =>
    chartFigure(`inputs-${k}`, `Input ${withUnit(name, unit)} against time`, el("ul.legend", legendItem("mark.knot", `${plural(knots.length, "knot")}, ${INTERPOLATION[kind] ?? short(kind)}`))),
  );
}

/** "true (the worst 3 of 8 rollouts)": the report data have the curves of the worst ones only. */
function variantKey(data, column, variant) {
  const drawn = column.traces.filter((each) => each.variant === variant).length;
  const all = data.rollouts.filter((each) => each.variant === variant).length;
  if (drawn === 0) return null;
  const number = drawn < all ? `the worst ${drawn} of ${plural(all, "rollout")}` : plural(drawn, "rollout");
  return legendItem(`key.${variant}`, `${variant} (${number})`);
}

function limitKey({ limits, unit }) {
  const values = limits.map((value) => num(value)).join(", ");
  return values && legendItem("key.limit", `limit of the specification: ${values} ${unitText(unit)}`);
}

/** Draw the curves of the selected test. */
function drawCurves(data) {
  columnsOf(data ?? { traces: [], limits: [] }).forEach((column, k) => {
    const host = document.getElementById(`curves-${k}`);
    if (host) drawColumn(host, column, k);
  });
  (data?.inputs ?? []).forEach((input, k) => {
    const host = document.getElementById(`inputs-${k}`);
    if (host) drawInput(host, input);
  });
}

/** Draw an input over the whole range of its knots, so that the inputs of all tests have one scale. */
function drawInput(host, { name, unit, t, values, knots, low, high }) {
  const margin = 0.06 * (high - low) || 0.5;
  const spec = {
    height: 160, x: "time (s)", y: { label: withUnit(name, unit), range: [low - margin, high + margin] }, legend: false,
    series: [{ label: short(name, 40), colour: "blue", width: 2 }, { label: "knots", colour: "ink", points: true, size: 6 }],
  };
  const places = new Set(knots);
  chart(host, spec, [t, values, t.map((each, k) => (places.has(each) ? values[k] : null))]);
}

function drawColumn(host, column, k) {
  const { traces, limits } = column;
  const ends = extent(...traces.map((each) => each.t));
  const tables = traces.map((each) => [each.t, each.values]);
  if (limits.length) tables.push([ends, ...limits.map((value) => [value, value])]);
  const series = [
    ...traces.map((each) => ({ label: short(each.label, 40), ...(VARIANTS[each.variant] ?? VARIANTS.true) })),
    ...limits.map((value) => ({ label: `limit ${num(value)}`, colour: "ink", dash: [2, 3] })),
  ];
  const spec = { height: 280, x: "time (s)", y: { label: withUnit(column.name, column.unit) }, series, legend: false };
  chart(host, spec, tables.length > 1 ? uPlot.join(tables) : tables[0], (plot) => readCurves(plot, host, k));
  host.column = column;
}

/** Write the values of the curves at the pointer. */
function readCurves(plot, host, k) {
  if (!(plot.cursor.left >= 0) || !host.column) return;
  const { traces, unit } = host.column;
  const t = plot.posToVal(plot.cursor.left, "x");
  const values = Object.keys(VARIANTS).map((variant) => {
    const range = extent(traces.filter((each) => each.variant === variant).map((each) => valueAt(each, t)));
    if (range === null) return "";
    const [low, high] = range;
    return `${variant} ${low === high ? "" : `${num(low)} to `}${quantity(high, unit)}`;
  });
  document.getElementById(`read-curves-${k}`).textContent = `t = ${num(t, 3)} s: ${values.filter(Boolean).join(", ")}`;
}

/** The value of a curve at a time, linear between its samples; null outside of them. */
function valueAt({ t, values }, time) {
  const after = t.findIndex((each) => each >= time);
  if (after < 0 || time < t[0]) return null;
  if (after === 0) return values[0];
  const share = (time - t[after - 1]) / (t[after] - t[after - 1] || 1);
  return values[after - 1] + share * (values[after] - values[after - 1]);
}

/** A table of rollouts; `cells` are the first cells of a row. In a report, which may be moved, commands are for its folder. */
function rolloutTable(heads, rollouts, cells) {
  const command = `Simulate again${document.body.dataset.live ? "" : " (in this folder)"}`;
  const robustness = (value) => (value < 0 ? el("strong.bad", num(value)) : num(value));
  const row = (each) => [...cells(each), robustness(each.robustness), each.seed, fileLink(each.path), commandLine(each.command)];
  return table([...heads, "#Robustness", "#Seed", "Trajectory (MCAP)", command], rollouts.map(row));
}

/** Rollouts that violate the specification, or the statement that there are none. */
function counterexampleSection(report) {
  const { counterexamples: found, violations, later_violations: later } = report;
  const head = el("h2", "Counterexamples");
  if (violations === 0) {
    const none = `None among ${plural(report.rollouts, "recorded rollout")}: no robustness is below 0.`;
    const text = report.specification === null ? "Not applicable: the campaign has no specification." : none;
    return el("section#counterexamples", { "data-violations": 0 }, head, el("p", text));
  }
  const name = (each) => `${words(each.problem)}, test ${each.test}`;
  // A check after the campaign has no section of its own.
  const test = (each) => (report.problems.some((problem) => problem.name === each.problem) ? el("button", { "data-select": `${each.problem}:${each.test}` }, name(each)) : name(each));
  const cells = (each) => [test(each), words(each.variant), place(each.x, report.axes)];
  const list = (rollouts) => rolloutTable(["Test", "Variant", "Start"], rollouts, cells);
  const rest = found.slice(FIRST_ROWS);
  return el(
    "section#counterexamples",
    { "data-violations": violations },
    head,
    el("p", el("strong.bad", plural(violations - later, "rollout")), ` of ${count(report.rollouts)} violated the specification (robustness below 0)${later ? `, and ${count(later)} after the campaign` : ""}, the worst first. Complete list: `, el("a", { href: "counterexamples.csv" }, "counterexamples.csv"), "."),
    found.length ? list(found.slice(0, FIRST_ROWS)) : null,
    rest.length ? el("details.more", el("summary", `${rest.length} more`), list(rest)) : null,
  );
}

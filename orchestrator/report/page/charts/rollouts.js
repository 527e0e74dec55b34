// Section of the selected test: why it is shown, its curves, its rollouts, and the commands that repeat them.

const INTERPOLATION = { pchip: "joined by monotone cubics", linear: "joined by straight lines", constant: "each held until the next one", sine: "a sine" };
const RANKS = { worst: "worst rollout", "first violation": "first violation", median: "median rollout", best: "best rollout" };

/**
 * The section of the selected test.
 * @param {{problem: string, test: number}|null} selected
 * @param {object|null|undefined} data rollouts of that test; null: there are none; undefined: being loaded
 */
function testSection(report, selected, data, live) {
  if (selected === null) return el("section#test", el("h2", "Trajectories of a test"), el("p.muted", "No test observed yet."));
  turnToTest(`${selected.problem}:${selected.test}`);
  const index = report.problems.findIndex((each) => each.name === selected.problem);
  const problem = report.problems[index]; // a closing check has none
  const k = problem ? problem.tests.test.indexOf(selected.test) : -1;
  return el(
    "section#test",
    { "data-problem": selected.problem, "data-test": selected.test, "data-curves": data?.traces.length ?? 0, "aria-busy": String(data === undefined), tabindex: -1 },
    el("h2", `Test ${count(selected.test)} of `, nameElement(words(selected.problem)), problem ? el("span.switch", neighbourButton(problem, k, -1), neighbourButton(problem, k, 1), el("a.back", { href: `#problem-${index}` }, "show map")) : null),
    rankedTests(report, selected),
    k >= 0 ? el("p", testText(report, problem, k)) : data?.x?.length ? el("p", `Start ${place(data.x, report.axes)}.`) : null,
    data?.error ? el("p.note.bad", short(data.error, 1000)) : null,
    data?.inputs.length ? inputFigures(data) : null,
    data?.traces.length ? curveFigures(report, data) : el("p.note", noCurves(selected, data, live)),
    data?.rollouts.length ? testRollouts(report, data) : null,
  );
}

/** Why this test is shown, and one button for each test that a reader wants first. */
function rankedTests(report, selected) {
  const ranked = rankedOf(report);
  if (!ranked.length) return null;
  const here = (each) => each.problem === selected.problem && each.test === selected.test;
  const button = (each) => el("button", { "data-select": `${each.problem}:${each.test}`, "aria-pressed": String(here(each)) }, RANKS[each.rank] ?? short(each.rank));
  return el("div.ranked", el("p.why", whyShown(report, ranked.filter(here), here)), el("span.switch", { role: "group", "aria-label": "Tests to look at first" }, ranked.map(button)));
}

function whyShown(report, ranks, here) {
  const found = report.counterexample;
  if (found !== null && here(found)) return "Shown because a rollout of this test violates the specification, which ended the campaign.";
  if (!ranks.length) return "";
  const [{ rank, variant, of, robustness, rollout }] = ranks;
  if (rollout === null) return `This test has the ${rank} observed value of ${plural(of, "test")}.`;
  const unit = unitText(report.scenes[0]?.margin_unit);
  const what = rank === "first violation" ? "the first violation among" : `the ${rank} of`;
  return [`This test has ${what} ${plural(of, `${variant} rollout`)}: robustness `, el(robustness < 0 ? "strong.bad" : "strong", `${num(robustness)} ${unit}`.trimEnd()), `, ${short(rollout)}.`];
}

/** The tests by rank; without a robustness by the observed values of the first problem. */
function rankedOf(report) {
  if (report.ranked.length) return report.ranked;
  const problem = report.problems.find((each) => worstFirst(report, each).length);
  if (!problem) return [];
  const rows = worstFirst(report, problem);
  const at = (rank, row) => ({ rank, problem: problem.name, test: problem.tests.test[row], rollout: null, of: rows.length });
  return [at("worst", rows[0]), at("median", rows[(rows.length - 1) >> 1]), at("best", rows.at(-1))];
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
  return `This report has no curves of this test. Its trajectories are the MCAP files of test ${count(selected.test)} in trajectories/${short(selected.problem)}/.`;
}

/** The input signals of the test's start, one picture each. */
function inputFigures(data) {
  return data.inputs.map(({ name, unit, kind, knots }, k) =>
    chartFigure(`inputs-${k}`, `Input ${withUnit(name, unit)} against time`, el("ul.legend", inputLegend(kind, knots.length))),
  );
}

/** The marks of the knots; of a sine, and of knots that are too many to mark, the words alone. */
function inputLegend(kind, knots) {
  const between = INTERPOLATION[kind] ?? short(kind);
  if (knots) return legendItem("mark.knot", `${plural(knots, "knot")}, ${between}`);
  return el("li", kind === "sine" ? between : `knots, ${between}`);
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

/** The rollouts of the test, those with curves with the key of theirs. */
function testRollouts(report, data) {
  const drawn = new Map(drawnRollouts(data).map((each) => [each.key, each]));
  const line = ({ id }) => (drawn.has(id) ? rolloutLine(drawn.get(id)) : el("span.key.none"));
  const cells = (each) => [el("span.variant", line(each), words(each.variant)), each.replicate];
  return rolloutTable(["Variant", "#Replicate"], data.rollouts, cells, { report, unit: data.margin_unit, onPaper: PAPER_ROWS });
}

/**
 * A table of rollouts; `cells` are the first cells of a row. In a report, which may be moved, commands are for its folder.
 * @param {{report: object, unit?: string, onPaper?: number, where?: string}} options unit of the robustness, the rows that paper shows, and where the others are
 */
function rolloutTable(heads, rollouts, cells, { report, unit = "", onPaper: rows = Infinity, where = "on the screen" }) {
  const disturbed = rollouts.some((each) => each.disturbances.length);
  const command = `Simulate again${document.body.dataset.live ? "" : " (in this folder)"}`;
  const robustness = (value) => (value < 0 ? el("strong.bad", num(value)) : num(value));
  const row = (each) => [...cells(each), robustness(each.robustness), ...(disturbed ? [disturbanceText(report, each.disturbances)] : []), each.seed, fileLink(each.path), commandLine(each.command)];
  const found = table([...heads, `#Robustness${unitText(unit) && ` (${unitText(unit)})`}`, ...(disturbed ? ["Disturbances"] : []), "#Seed", "Trajectory (MCAP)", command], rollouts.map(row));
  found.classList.add("rollouts");
  return [found, shortenedOnPaper(found, rows, where)];
}

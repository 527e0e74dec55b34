"use strict";
// One test: its curves, its rollouts, how to simulate them again; and the rollouts that violate the specification.

const VARIANTS = {
  nominal: { colour: "blue", width: 3, dash: [8, 5] },
  true: { colour: "red", width: 1.1 },
};
const FIRST_ROWS = 10;

/**
 * The panel of the selected test.
 * @param {{problem: string, test: number}|null} selected
 * @param {object|null|undefined} scene null: there is none; undefined: it is on its way
 */
function sceneSection(story, selected, scene, live) {
  const problem = story.problems.find((each) => each.name === selected?.problem);
  if (!problem) return el("section#scene", {}, el("h2", {}, "Trajectories of a test"), el("p.muted", {}, "No test has been observed yet."));
  const k = problem.tests.test.indexOf(selected.test);
  return el(
    "section#scene",
    { "data-problem": selected.problem, "data-test": String(selected.test), "data-curves": scene?.traces.length ?? 0, "aria-busy": String(scene === undefined), tabindex: -1 },
    el("h2", {}, `Test ${selected.test} of `, named(words(selected.problem)), el("span.switch", {}, neighbour(problem, k, -1), neighbour(problem, k, 1), el("a.back", { href: `#problem-${story.problems.indexOf(problem)}` }, "to its map"))),
    k < 0 ? null : el("p", {}, sceneWords(story, problem, k)),
    scene?.error ? el("p.note.bad", {}, short(scene.error, 1000)) : null,
    scene?.traces.length ? sceneFigures(scene) : el("p.note", {}, noCurves(selected, scene, live)),
    scene?.rollouts.length ? rolloutTable(scene.rollouts) : null,
  );
}

function neighbour(problem, k, step) {
  const test = problem.tests.test[k + step];
  const name = step < 0 ? "\u2190 test before" : "test after \u2192";
  return el("button", { type: "button", "data-select": `${problem.name}:${test}`, disabled: k < 0 || test === undefined }, name);
}

function sceneWords(story, problem, k) {
  const { x, y, distance } = problem.tests;
  const rank = worstFirst(story, problem).indexOf(k);
  const nth = rank === 0 ? ", the worst observed test of this problem" : "";
  const left = distance[k] === null ? "" : `; ${short(problem.distance, 20)} was ${quantity(distance[k], problem.unit)}`;
  return `From ${place(x[k], story.axes)}: observed ${quantity(y[k], problem.unit)}${nth}${left}.`;
}

function noCurves(selected, scene, live) {
  if (scene === undefined) return "Its trajectories are on their way.";
  if (scene) return "Its rollouts have no curves: each is a single number, or its file could not be read.";
  if (live) return "The orchestrator has no trajectories of this test.";
  return `The curves of this test are not in this page. Its trajectories are in the MCAP files of test ${selected.test} below trajectories/${short(selected.problem)}/.`;
}

/** The columns of a scene, each with its traces (nominal ones last, so on top) and its limits. */
function columnsOf(scene) {
  const names = [...new Set(scene.traces.map((each) => each.column))];
  return names.map((name) => {
    const traces = scene.traces.filter((each) => each.column === name);
    const limits = scene.limits.filter((_, k) => (scene.limit_columns?.[k] ?? names[0]) === name);
    traces.sort((a, b) => (a.variant === "nominal") - (b.variant === "nominal"));
    return { name, unit: traces[0].unit, traces, limits };
  });
}

function sceneFigures(scene) {
  return columnsOf(scene).map((column, k) =>
    el(
      "figure",
      {},
      el("figcaption", {}, `${withUnit(column.name, column.unit)} against time`),
      chartHost(`curves-${k}`, `${short(column.name, 40)} of the rollouts against time`),
      el(`p.readout#read-curves-${k}`, { "data-keep": `read-curves-${k}` }, "Point at the curves to read them."),
      el("ul.legend", {}, variantKey(scene, column, "nominal"), variantKey(scene, column, "true"), limitKey(column)),
    ),
  );
}

/** "true (3 of 8 rollouts)": the story draws the worst replicates only. */
function variantKey(scene, column, variant) {
  const drawn = column.traces.filter((each) => each.variant === variant).length;
  const all = scene.rollouts.filter((each) => each.variant === variant).length;
  if (drawn === 0) return null;
  const many = drawn < all ? `the worst ${drawn} of ${plural(all, "rollout")}` : plural(drawn, "rollout");
  return el("li", {}, el(`span.key.${variant}`), `${variant} (${many})`);
}

function limitKey({ limits, unit }) {
  if (limits.length === 0) return null;
  const values = limits.map((value) => num(value)).join(", ");
  return el("li", {}, el("span.key.limit"), `limit of the specification: ${values} ${unitText(unit)}`);
}

/** Draw the curves into the panel. */
function drawScene(scene) {
  columnsOf(scene ?? { traces: [], limits: [] }).forEach((column, k) => {
    const host = document.getElementById(`curves-${k}`);
    if (host) drawColumn(host, column, k);
  });
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
  const spec = { height: 280, x: { label: "time (s)" }, y: { label: withUnit(column.name, column.unit) }, series, legend: false };
  chart(host, spec, tables.length > 1 ? uPlot.join(tables) : tables[0], (plot) => readCurves(plot, host, k));
  host.column = column;
}

/** Say the values of the curves under the pointer. */
function readCurves(plot, host, k) {
  if (!(plot.cursor.left >= 0) || !host.column) return;
  const { traces, unit } = host.column;
  const t = plot.posToVal(plot.cursor.left, "x");
  const said = Object.keys(VARIANTS).map((variant) => {
    const range = extent(traces.filter((each) => each.variant === variant).map((each) => valueAt(each, t)));
    if (range === null) return "";
    const [low, high] = range;
    return `${variant} ${low === high ? "" : `${num(low)} to `}${quantity(high, unit)}`;
  });
  document.getElementById(`read-curves-${k}`).textContent = `t = ${num(t, 3)} s: ${said.filter(Boolean).join(", ")}`;
}

/** The value of a trace at a time, straight between its samples; null outside of them. */
function valueAt({ t, values }, time) {
  const after = t.findIndex((each) => each >= time);
  if (after < 0 || time < t[0]) return null;
  if (after === 0) return values[0];
  const share = (time - t[after - 1]) / (t[after] - t[after - 1] || 1);
  return values[after - 1] + share * (values[after] - values[after - 1]);
}

/** The report says `.` for the run directory, in which it lies. */
function again() {
  return document.body.dataset.live ? "Simulate it again" : "Simulate it again, in this folder";
}

function rolloutTable(rollouts, attributes = {}) {
  const row = (each) => [
    words(each.variant), String(each.replicate), robustnessCell(each), String(each.seed), fileLink(each.path), commandLine(each.command),
  ];
  return table(["Variant", "#Replicate", "#Robustness", "#Seed", "Trajectory (MCAP)", again()], rollouts.map(row), { class: "rollouts", ...attributes });
}

function robustnessCell(rollout) {
  return rollout.robustness < 0 ? el("strong.bad", {}, num(rollout.robustness)) : num(rollout.robustness);
}

/** Rollouts below zero; that there are none is said too. */
function counterexampleSection(story) {
  const { counterexamples: found, violations } = story;
  const head = el("h2", {}, "Counterexamples");
  if (violations === 0) {
    const some = `None: of ${plural(story.rollouts, "recorded rollout")}, none has a robustness below 0.`;
    const none = story.specification === null ? "None can be: the campaign has no specification." : some;
    return el("section#counterexamples", { "data-violations": 0 }, head, el("p", {}, none));
  }
  const row = (each) => [
    el("button", { type: "button", "data-select": `${each.problem}:${each.test}` }, `${words(each.problem)}, test ${each.test}`),
    words(each.variant), place(each.x, story.axes), robustnessCell(each), String(each.seed), fileLink(each.path), commandLine(each.command),
  ];
  const heads = ["Test", "Variant", "Start", "#Robustness", "#Seed", "Trajectory (MCAP)", again()];
  const list = (rows) => table(heads, rows.map(row), { class: "rollouts" });
  const rest = found.slice(FIRST_ROWS);
  return el(
    "section#counterexamples",
    { "data-violations": violations },
    head,
    el("p", {}, el("strong.bad", {}, plural(violations, "rollout")), ` of ${count(story.rollouts)} violated the specification (robustness below 0), the worst first. All of them: `, el("a", { href: "counterexamples.csv" }, "counterexamples.csv"), "."),
    found.length ? list(found.slice(0, FIRST_ROWS)) : null,
    rest.length ? el("details.more", {}, el("summary", {}, `${rest.length} more`), list(rest)) : null,
  );
}

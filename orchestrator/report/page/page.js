// State and drawing of the page, input of the reader, event stream of a live page.

const page = {
  report: null,
  live: null, // URL of the event stream, null in a report
  chosen: null, // {problem, test} selected by the reader; null: the worst test of the first problem
  series: new Map(), // problem -> series on its map
  axes: new Map(), // problem -> numbers of the two axes of its map
  pointer: new Map(), // index of a problem -> {canvas, at: [x, y] on it, row of the test there or null}
  fetched: new Map(), // "problem:test" -> rollouts of that test, null (there are none) or undefined (being loaded)
  connection: "connecting",
  updated: null, // Date.now() of the last event
  drawn: 0, // number of drawings
  width: 0, // of the page, in CSS pixels
};
const MOST_FETCHED = 40;

/** Draw the whole page; unchanged elements and charts are kept. */
function draw() {
  const { report } = page;
  if (report === null) return;
  const selected = selection();
  const data = selected && rolloutsOf(selected);
  morph(document.getElementById("page"), tree(report, selected, data));
  report.problems.forEach((problem, index) => {
    redrawMaps(index);
    drawProblemCharts(report, problem, index);
    drawRegions(report, problem, index);
  });
  drawCurves(data);
  drawWorst(report);
  writeMargins(report);
  drawThroughput(report.throughput);
  tidyCharts();
  page.drawn += 1;
  document.documentElement.dataset.drawn = page.drawn;
}

function tree(report, selected, data) {
  return el(
    "main#page",
    page.live === null ? null : statusLine(),
    titleSection(report),
    holdingSection(report),
    claimSection(report),
    testedSection(report),
    compositionSection(report),
    report.problems.map((problem, index) => regionSection(report, problem, index)),
    checkSection(report),
    assumptionSection(report),
    report.problems.map((problem, index) => problemSection(report, index, shownOn(problem), selected)),
    testSection(report, selected, data, page.live !== null),
    counterexampleSection(report),
    workerSection(report),
    aboutSection(report),
    outputSection(report),
    glossarySection(),
  );
}

/**
 * Series and axes on the map of a problem: the choice of the reader, else the first two axes, and the mean; of listed
 * starts the claimed bound.
 */
function shownOn(problem) {
  const bound = problem.sense === "max" ? "upper" : "lower";
  const read = readAxes(page.report);
  const first = (read.length > 1 ? read : page.report.axes.map((_, k) => k)).slice(0, 2);
  return { series: page.series.get(problem.name) ?? (isListed(problem) ? bound : "mean"), chosen: page.axes.get(problem.name) ?? first };
}

/** The selected test: the choice of the reader, else the counterexample, else that of the worst rollout. */
function selection() {
  if (page.chosen !== null) return page.chosen;
  return page.report.counterexample ?? rankedOf(page.report)[0] ?? null;
}

/** The rollouts of a test: from the report data, or fetched once. */
function rolloutsOf(selected) {
  const found = page.report.scenes.find((each) => each.problem === selected.problem && each.test === selected.test);
  if (page.live === null || (found && !lacksColumns(found))) return found ?? null;
  const key = `${selected.problem}:${selected.test}`;
  if (!page.fetched.has(key)) fetchRollouts(key, selected);
  return page.fetched.get(key) ?? found;
}

async function fetchRollouts(key, selected) {
  page.fetched.set(key, undefined);
  const query = new URLSearchParams({ problem: selected.problem, test: selected.test });
  try {
    const answer = await fetch(`scene?${query}`);
    page.fetched.set(key, answer.ok ? await answer.json() : null);
  } catch {
    page.fetched.delete(key); // no connection: the next drawing tries again
    return;
  }
  if (page.fetched.size > MOST_FETCHED) page.fetched.delete(page.fetched.keys().next().value);
  draw();
}

/** Draw the pictures of the tests of a problem: the map of two parameters, and the lines over all. */
function redrawMaps(index) {
  const { report } = page;
  const problem = report.problems[index];
  const selected = selection();
  const pointer = page.pointer.get(index);
  const view = (canvas) => ({
    report, problem,
    kind: mapKind(report, problem),
    ...shownOn(problem),
    selected: selected?.problem === problem.name ? selected.test : null,
    pointer: pointer?.canvas === canvas.id ? pointer.at : null,
    pointed: pointer?.row ?? null,
  });
  for (const [name, drawOn] of [["map", drawMap], ["parallel", drawParallel]]) {
    const canvas = document.getElementById(`${name}-${index}`);
    if (canvas instanceof HTMLCanvasElement) drawOn(canvas, view(canvas));
  }
}

/** Select "problem:test" (a problem's name may contain colons, a number none), and scroll to its section on request. */
function select(text, scroll) {
  const cut = text.lastIndexOf(":");
  page.chosen = { problem: text.slice(0, cut), test: Number(text.slice(cut + 1)) };
  draw();
  if (!scroll) return;
  const section = document.getElementById("test");
  section.focus({ preventScroll: true });
  section.scrollIntoView();
}

// Input of the reader ------------------------------------------------------------------------------------------------

function onClick(event) {
  const term = event.target.closest("a.term");
  if (term !== null) document.querySelector(`${term.getAttribute("href")}`).closest("details").open = true;
  const target = event.target.closest("[data-select], [data-series], [data-copy], canvas[data-index]");
  if (target === null) return;
  if (target instanceof HTMLCanvasElement) {
    movePointer(target, [event.offsetX, event.offsetY]); // a finger comes without moving there
    selectOnMap(target);
  } else if (target.dataset.copy !== undefined) copy(target);
  else if (target.dataset.select !== undefined) select(target.dataset.select, target.closest("#test") === null);
  else {
    page.series.set(target.dataset.problem, target.dataset.series);
    draw();
  }
}

/** Select the worst test that the reader points at; repeated, the next test there. */
function selectOnMap(canvas) {
  const view = mapModels.get(canvas);
  const dot = view?.dots.find((each) => each.pointed);
  if (!dot) return;
  const tests = dot.rows.map((k) => view.problem.tests.test[k]);
  const next = tests[(tests.indexOf(view.selected) + 1) % tests.length];
  select(`${view.problem.name}:${next}`, true);
}

function onPointer(event) {
  if (mapModels.has(event.target)) movePointer(event.target, [event.offsetX, event.offsetY]);
}

/** Point at a pixel of a canvas (nowhere for null), by default at the test there, and write the values. */
function movePointer(canvas, at, dot = at && mapModels.get(canvas).dotAt(at)) {
  const index = Number(canvas.dataset.index);
  if (at === null) page.pointer.delete(index);
  else page.pointer.set(index, { canvas: canvas.id, at, row: dot?.rows[0] ?? null });
  redrawMaps(index);
  const text = at === null ? "" : readout(mapModels.get(canvas));
  if (text) document.getElementById(canvas.getAttribute("aria-describedby")).textContent = text;
}

/** Take a choice of an axis; the other axis gets the former one where both would be the same. */
function chooseAxis({ dataset: { problem, axis }, value }) {
  const { chosen } = shownOn(page.report.problems.find((each) => each.name === problem));
  const [place, wanted] = [Number(axis), Number(value)];
  const next = chosen.map((k, at) => (at === place ? wanted : k === wanted ? chosen[place] : k));
  page.axes.set(problem, next);
  draw();
  for (const each of document.querySelectorAll("select[data-axis]")) if (each.dataset.problem === problem) each.value = next[each.dataset.axis];
}

function onPointerOut(event) {
  if (mapModels.has(event.target)) movePointer(event.target, null);
}

/** On a map the arrow keys move between tests, Enter selects one. */
function onKey(event) {
  const canvas = event.target;
  if (!mapModels.has(canvas)) return;
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  const view = mapModels.get(canvas);
  if (event.key === "Enter" && view.pointer) selectOnMap(canvas);
  else if (step && view.dots.length) {
    const at = view.pointer ? view.dots.findIndex((each) => each.pointed) : step < 0 ? 0 : -1;
    const dot = view.dots[(at + step + view.dots.length) % view.dots.length];
    movePointer(canvas, dot.at ?? dot.path[0], dot);
  } else return;
  event.preventDefault();
}

// The width of the page, and paper ------------------------------------------------------------------------------------

/** Draw again after a change of width; drawing itself changes the height. */
function onResize([{ contentRect }]) {
  if (contentRect.width !== page.width) draw();
  page.width = contentRect.width;
}

let unfolded = [];

/** Draw in the colours and width of paper with every <details> open that paper does not leave out, and afterwards as before. */
function setPrinting(begins) {
  printing = begins;
  document.body.classList.toggle("paper", begins);
  if (begins) unfolded = [...document.querySelectorAll("details:not([open], [data-paper=folded])")];
  if (page.report !== null) printTitle(page.report, begins);
  for (const each of unfolded) each.open = begins;
  draw();
}

function start() {
  page.live = document.body.dataset.live ?? null;
  const text = document.getElementById("story").textContent.trim();
  document.addEventListener("change", ({ target }) => target.dataset.axis !== undefined && chooseAxis(target));
  const listeners = { click: onClick, pointermove: onPointer, pointerdown: onPointer, pointerout: onPointerOut, keydown: onKey };
  for (const [name, listener] of Object.entries(listeners)) document.addEventListener(name, listener);
  window.addEventListener("beforeprint", () => setPrinting(true));
  window.addEventListener("afterprint", () => setPrinting(false));
  for (const query of [dark, onPaper]) query.addEventListener("change", draw);
  new ResizeObserver(onResize).observe(document.getElementById("page"));
  if (text !== "") page.report = JSON.parse(text);
  else document.getElementById("page").append(el("p#reading", "Reading the campaign\u2026"));
  draw();
  if (page.live !== null) follow();
}

document.addEventListener("DOMContentLoaded", start);

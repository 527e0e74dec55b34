"use strict";
// The page: a story comes in, everything is drawn from it. What the reader chose stays.

const page = {
  story: null,
  live: null, // address of the events, null in a report
  chosen: null, // {problem, test} that the reader selected; null follows the worst test of the first problem
  series: new Map(), // problem -> what its map shows
  hover: new Map(), // index of a problem -> [x, y] on its map
  scenes: new Map(), // "problem:test" -> scene, null (there is none) or undefined (on its way)
  connection: "connecting",
  seen: null, // Date.now() when the last story came
  drawn: 0,
  width: 0, // of the page, in CSS pixels
};
const MOST_SCENES = 40;
const [RETRY, LONGEST_RETRY] = [1000, 15_000]; // milliseconds

/** Draw everything again; cheap where nothing changed. */
function draw() {
  const { story } = page;
  if (story === null) return;
  const selected = selection();
  const scene = selected && sceneOf(selected);
  morph(document.getElementById("page"), tree(story, selected, scene));
  story.problems.forEach((problem, index) => {
    redrawMap(index);
    drawProblemCharts(problem, index);
  });
  drawScene(scene);
  drawThroughput(story.throughput);
  tidyCharts();
  page.drawn += 1;
  document.documentElement.dataset.drawn = page.drawn;
}

function tree(story, selected, scene) {
  return el(
    "main#page",
    {},
    page.live === null ? null : statusLine(),
    titleSection(story),
    claimSection(story),
    compositionSection(story),
    assumptionSection(story),
    story.problems.map((problem, index) => problemSection(story, index, shownSeries(problem), selected)),
    sceneSection(story, selected, scene, page.live !== null),
    counterexampleSection(story),
    fleetSection(story),
    softwareSection(story),
  );
}

/** What the map of a problem shows: what the reader chose, else the mean, of starts the bound that counts. */
function shownSeries(problem) {
  const bound = problem.sense === "max" ? "upper" : "lower";
  return page.series.get(problem.name) ?? (problem.surface?.shape === null ? bound : "mean");
}

/** The test that the panel shows: what the reader chose, else the worst of the first problem that has one. */
function selection() {
  if (page.chosen !== null) return page.chosen;
  for (const problem of page.story.problems) {
    const [worst] = worstFirst(page.story, problem);
    if (worst !== undefined) return { problem: problem.name, test: problem.tests.test[worst] };
  }
  return null;
}

/** The scene of a test: from the story, from what was fetched, or on its way. */
function sceneOf(selected) {
  const found = page.story.scenes.find((each) => each.problem === selected.problem && each.test === selected.test);
  if (found || page.live === null) return found ?? null;
  const key = `${selected.problem}:${selected.test}`;
  if (!page.scenes.has(key)) fetchScene(key, selected);
  return page.scenes.get(key);
}

async function fetchScene(key, selected) {
  page.scenes.set(key, undefined);
  const query = new URLSearchParams({ problem: selected.problem, test: selected.test });
  try {
    const answer = await fetch(`scene?${query}`);
    page.scenes.set(key, answer.ok ? await answer.json() : null);
  } catch {
    page.scenes.delete(key); // the next drawing asks again
    return;
  }
  if (page.scenes.size > MOST_SCENES) page.scenes.delete(page.scenes.keys().next().value);
  draw();
}

function redrawMap(index) {
  const { story } = page;
  const canvas = document.getElementById(`map-${index}`);
  if (!(canvas instanceof HTMLCanvasElement)) return;
  const problem = story.problems[index];
  const selected = selection();
  drawMap(canvas, {
    story, problem,
    kind: mapKind(story, problem),
    series: shownSeries(problem),
    selected: selected?.problem === problem.name ? selected.test : null,
    hover: page.hover.get(index) ?? null,
  });
  canvas.dataset.updated = page.drawn + 1;
}

/** Select "problem:test"; the name of a problem may hold a colon, a number cannot. `go`: bring its panel into view. */
function select(text, go) {
  const cut = text.lastIndexOf(":");
  page.chosen = { problem: text.slice(0, cut), test: Number(text.slice(cut + 1)) };
  draw();
  if (!go) return;
  const panel = document.getElementById("scene");
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  panel.focus({ preventScroll: true });
  panel.scrollIntoView({ behavior: calm ? "auto" : "smooth", block: "start" });
}

// What the reader does ------------------------------------------------------------------------------------------------

function clicked(event) {
  const target = event.target.closest("[data-select], [data-series], [data-copy], canvas[data-index]");
  if (target === null) return;
  if (target instanceof HTMLCanvasElement) clickedMap(target, [event.offsetX, event.offsetY]);
  else if (target.dataset.copy !== undefined) copy(target);
  else if (target.dataset.select !== undefined) select(target.dataset.select, target.closest("#scene") === null);
  else {
    page.series.set(target.dataset.problem, target.dataset.series);
    draw();
  }
}

/** Show the worst test of the dot that was clicked; another click shows the next one there. */
function clickedMap(canvas, pixel) {
  const view = views.get(canvas);
  const dot = view && dotNear(view, pixel);
  if (!dot) return;
  const tests = dot.rows.map((k) => view.problem.tests.test[k]);
  const next = tests[(tests.indexOf(view.selected) + 1) % tests.length];
  select(`${view.problem.name}:${next}`, true);
}

function pointed(event) {
  if (event.target instanceof HTMLCanvasElement && event.target.dataset.index !== undefined) point(event.target, [event.offsetX, event.offsetY]);
}

/** Read a map at a pixel, or at none. */
function point(canvas, pixel) {
  const index = Number(canvas.dataset.index);
  page.hover.set(index, pixel);
  redrawMap(index);
  const said = pixel === null ? "" : readout(views.get(canvas), pixel);
  if (said) document.getElementById(`read-${index}`).textContent = said;
}

function left(event) {
  if (event.target instanceof HTMLCanvasElement && event.target.dataset.index !== undefined) point(event.target, null);
}

/** On a map the arrows go from test to test, Enter shows one. */
function pressed(event) {
  const canvas = event.target;
  if (!(canvas instanceof HTMLCanvasElement) || !views.has(canvas)) return;
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  const view = views.get(canvas);
  if (event.key === "Enter" && view.hover) clickedMap(canvas, view.hover);
  else if (step && view.dots.length) {
    const at = view.hover ? view.dots.indexOf(dotNear(view, view.hover)) : step < 0 ? 0 : -1;
    point(canvas, dotAt(view, view.dots[(at + step + view.dots.length) % view.dots.length]));
  } else return;
  event.preventDefault();
}

// The live page -------------------------------------------------------------------------------------------------------

function statusLine() {
  const time = page.seen === null ? null : new Date(page.seen).toTimeString().slice(0, 8);
  const said = {
    connecting: "connecting",
    live: `live; last look at ${time}`,
    lost: `connection lost, trying again${time ? `; last look at ${time}` : ""}`,
    ended: `the campaign has ended; last look at ${time}`,
  }[page.connection];
  return el("p#live", { role: "status", "data-connection": page.connection }, said);
}

function connected(state) {
  page.connection = state;
  if (page.story !== null) morph(document.getElementById("live"), statusLine());
}

/** Listen to the orchestrator. A browser tries again by itself unless the server refused: then we do, ever slower. */
function listen(wait = RETRY) {
  const source = new EventSource(page.live);
  source.addEventListener("story", (event) => {
    wait = RETRY;
    page.connection = "live";
    page.seen = Date.now();
    show(JSON.parse(event.data));
  });
  source.onopen = () => connected("live");
  source.onerror = () => {
    if (page.story?.state === "finished") {
      source.close(); // nothing more will come
      connected("ended");
      return;
    }
    connected("lost");
    if (source.readyState !== EventSource.CLOSED) return;
    source.close();
    setTimeout(() => listen(Math.min(2 * wait, LONGEST_RETRY)), wait);
  };
}

let waiting = null;

/** Draw a story at the next picture of the screen; of several that wait, the newest. */
function show(story) {
  if (waiting === null) requestAnimationFrame(() => ((page.story = waiting), (waiting = null), draw()));
  waiting = story;
}

/** Draw again if the page became wider or narrower; it becomes longer by itself. */
function widened([{ contentRect }]) {
  if (contentRect.width !== page.width) draw();
  page.width = contentRect.width;
}

let unfolded = [];

/** Draw in the colours and about the width of paper, with everything unfolded. */
function paper(begins) {
  printing = begins;
  document.body.classList.toggle("paper", begins);
  if (begins) unfolded = [...document.querySelectorAll("details:not([open])")];
  for (const each of unfolded) each.open = begins;
  draw();
}

function start() {
  page.live = document.body.dataset.live ?? null;
  const text = document.getElementById("story").textContent.trim();
  document.addEventListener("click", clicked);
  document.addEventListener("pointermove", pointed);
  document.addEventListener("pointerdown", pointed);
  document.addEventListener("pointerout", left);
  document.addEventListener("keydown", pressed);
  window.addEventListener("beforeprint", () => paper(true));
  window.addEventListener("afterprint", () => paper(false));
  for (const query of [dark, onPaper]) query.addEventListener("change", draw);
  new ResizeObserver(widened).observe(document.getElementById("page"));
  if (text !== "") page.story = JSON.parse(text);
  draw();
  if (page.live !== null) listen();
}

document.addEventListener("DOMContentLoaded", start);

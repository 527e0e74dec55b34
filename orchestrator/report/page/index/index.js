// The index of many campaigns: its rows, filters and order, and the changes that its server reports.

const VERDICTS = ["SHOWN", "VIOLATED", "NOT SHOWN"];
const UNREADABLE = ["damaged", "other version"];
const STATES = ["running", "finished", "stopped", ...UNREADABLE];
const [POLL, LONGEST_POLL] = [2000, 30_000]; // milliseconds
const SOON = 150; // milliseconds: while campaigns are read for the first time

/** Columns: heading, key in the choices, order of two rows (ascending), whether the first click sorts descending. */
const COLUMNS = [
  { name: "Campaign", key: "name", by: byText((row) => `${row.name}\n${row.path}`) },
  { name: "Verdict", key: "verdict", by: byNumber((row) => (row.verdict === null ? null : VERDICTS.indexOf(row.verdict))) },
  { name: "First claim", key: "claim", by: byNumber((row) => row.value), number: true, falling: true },
  { name: "Required", key: "required", by: byText((row) => row.required), number: true },
  { name: "State", key: "state", by: byNumber((row) => STATES.indexOf(row.state)) },
  { name: "Rollouts", key: "rollouts", by: byNumber((row) => row.rollouts), number: true, falling: true },
  { name: "Violations", key: "violations", by: byNumber((row) => row.violations), number: true, falling: true },
  { name: "Last change", key: "changed", by: byNumber((row) => row.changed), number: true, falling: true },
];
const START = { verdict: "", state: "", search: "", order: "changed", falling: true };

const index = {
  rows: new Map(), // path -> row of the server
  shown: new Map(), // path -> {row, element}
  choices: { ...START },
  stamp: "",
  folder: "",
  start: "", // command that starts a campaign in the folder
  unread: 0,
  more: false,
  skew: 0, // seconds by which the clock of the server is ahead
  connection: "live",
  drawn: 0, // number of drawings
};

function byText(of) {
  return (a, b) => of(a).localeCompare(of(b), "en", { numeric: true });
}

/** Rows without a number come last, whatever the direction. */
function byNumber(of) {
  return (a, b, falling) => {
    const [first, second] = [of(a), of(b)];
    if (first === null || second === null) return (first === null) - (second === null) || 0;
    return falling ? second - first : first - second;
  };
}

// Rows in order --------------------------------------------------------------------------------------------------------

/** The rows that the choices allow, in their order; in the order of time those that run come first. */
function chosenRows() {
  const { order, falling } = index.choices;
  const { by, number } = COLUMNS.find((each) => each.key === order);
  const numeric = number || order === "verdict" || order === "state";
  const compare = numeric && order !== "required" ? (a, b) => by(a, b, falling) : (a, b) => (falling ? by(b, a) : by(a, b));
  const running = (row) => (order === "changed" && falling && row.state === "running" ? 0 : 1);
  const path = byText((row) => row.path);
  return [...index.rows.values()].filter(isChosen).sort((a, b) => running(a) - running(b) || compare(a, b) || path(a, b));
}

function isChosen(row) {
  const { verdict, state, search } = index.choices;
  if (state && row.state !== state) return false;
  if (verdict && (row.verdict ?? "none") !== verdict) return false;
  const text = [row.name, row.path, row.state, row.verdict ?? "", row.claim, row.reason, row.fault].join(" ").toLowerCase();
  return search.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

// Drawing --------------------------------------------------------------------------------------------------------------

function drawIndex() {
  const rows = chosenRows();
  const main = document.getElementById("index");
  const next = el(
    "main#index",
    connectionLine(),
    el("p.kind", "perfbound campaigns"),
    el("h1", nameElement(index.folder, 120)),
    el("p.printed.muted", `as of ${utc(Date.now() / 1000 + index.skew)}`),
    index.rows.size ? summary() : firstSteps(),
    index.rows.size ? choiceBar() : null,
    index.rows.size ? el("p.muted#found", { role: "status" }, foundText(rows.length)) : null,
    index.rows.size ? headOfTable() : null,
  );
  morph(main, next);
  const body = document.querySelector("#campaigns tbody");
  if (body) placeRows(body, rows);
  else index.shown.clear();
  index.drawn += 1;
  document.documentElement.dataset.drawn = index.drawn;
  document.documentElement.dataset.unread = index.unread;
}

function connectionLine() {
  const lost = index.connection === "lost";
  return el("p#live", { role: "status", "data-connection": index.connection }, lost ? "connection lost, retrying; the rows are those of before" : "live: new and changed campaigns appear here");
}

/** "200 campaigns: 2 running, 120 SHOWN, ...". */
function summary() {
  const rows = [...index.rows.values()];
  const counted = (what, number) => (number ? [`${count(number)} ${what}`] : []);
  const parts = [
    ...counted("running", rows.filter((row) => row.state === "running").length),
    ...VERDICTS.flatMap((word) => counted(word, rows.filter((row) => row.verdict === word).length)),
    ...counted("stopped", rows.filter((row) => row.state === "stopped").length),
    ...UNREADABLE.flatMap((state) => counted(state, rows.filter((row) => row.state === state).length)),
    ...counted("being read", index.unread),
  ];
  const more = index.more ? "; there are more than this page shows: name a smaller folder" : "";
  return el("p.counts", `${plural(rows.length, "campaign")}: ${parts.join(", ")}${more}`);
}

function foundText(number) {
  const all = index.rows.size;
  return number === all ? `All ${plural(all, "campaign")} shown.` : `${count(number)} of ${plural(all, "campaign")} shown.`;
}

function firstSteps() {
  return el(
    "section#empty",
    el("h2", "There is no campaign here yet"),
    el("p", "Start one, and it appears on this page:"),
    commandLine(index.start),
    el("p", "CAMPAIGN.toml is its campaign file. To write one for a system of yours, with constants from rollouts of it:"),
    commandLine("perfbound init SYSTEM.py:NAME"),
  );
}

function choiceBar() {
  const { verdict, state, order, falling } = index.choices;
  const option = (value, text, chosen) => el("option", { value, selected: value === chosen }, text);
  const verdicts = [["", "all verdicts"], ...VERDICTS.map((word) => [word, word]), ["none", "none yet"]];
  const orders = COLUMNS.flatMap(({ name, key }) => [[`${key} up`, `${name}, ascending`], [`${key} down`, `${name}, descending`]]);
  return el(
    "form.choices", { role: "search", "data-choices": "" },
    el("label.search", "Search", el("input", { type: "search", name: "search", placeholder: "name, folder, reason", autocomplete: "off", spellcheck: "false" })),
    el("label", "Verdict", el("select", { name: "verdict" }, verdicts.map(([value, text]) => option(value, text, verdict)))),
    el("label", "State", el("select", { name: "state" }, [["", "all states"], ...STATES.map((each) => [each, each])].map(([value, text]) => option(value, text, state)))),
    el("label.order", "Order", el("select", { name: "order" }, orders.map(([value, text]) => option(value, text, `${order} ${falling ? "down" : "up"}`)))),
    el("button", { type: "reset" }, "Show all"),
  );
}

/** The table without its rows, which keep their elements: see placeRows. */
function headOfTable() {
  const { order, falling } = index.choices;
  const sort = (key) => (key === order ? (falling ? "descending" : "ascending") : null);
  const head = ({ name, key, number }) =>
    el(`th${number ? ".number" : ""}`, { scope: "col", role: "columnheader", "aria-sort": sort(key) }, el("button", { type: "button", "data-order": key }, name));
  return el(
    "table#campaigns", { role: "table", "aria-label": "Campaigns" },
    el("thead", { role: "rowgroup" }, el("tr", { role: "row" }, COLUMNS.map(head))),
    el("tbody", { role: "rowgroup", "data-keep": "" }),
  );
}

/** Give the body of the table these rows in this order; an element is made again only where its row changed. */
function placeRows(body, rows) {
  const active = document.activeElement;
  const paths = new Set(rows.map((row) => row.path));
  for (const [path, { element }] of index.shown) {
    if (paths.has(path)) continue;
    element.remove();
    index.shown.delete(path);
  }
  let place = body.firstElementChild;
  for (const row of rows) {
    const element = elementOf(row);
    if (element === place) place = place.nextElementSibling;
    else body.insertBefore(element, place);
  }
  if (active !== document.activeElement && active?.isConnected) active.focus({ preventScroll: true });
}

function elementOf(row) {
  const shown = index.shown.get(row.path);
  if (shown?.row === row) return shown.element;
  const element = rowElement(row);
  if (shown) morph(shown.element, element);
  const kept = shown?.element ?? element;
  index.shown.set(row.path, { row, element: kept });
  return kept;
}

function rowElement(row) {
  const cell = (label, attributes, ...children) => el("td", { role: "cell", "data-label": label, ...attributes }, children);
  const unread = row.state === "unread";
  const number = (value) => (unread || UNREADABLE.includes(row.state) ? "\u2013" : count(value));
  return el(
    "tr", { role: "row", "data-path": visible(row.path) },
    el("td.campaign", { role: "cell" }, linkTo(row), row.path === row.name ? null : el("span.small", shortMiddle(row.path, 120)), row.fault ? el("span.small.bad", short(row.fault, 300)) : null),
    cell("Verdict", { "data-verdict": row.verdict }, el("span.word", row.verdict ?? "\u2013"), row.reason ? el("span.small", sentence(row.reason, 160)) : null),
    cell("First claim", { class: "number nowrap", title: row.claim || null }, claimOf(row), row.refuted ? el("span.small.bad", "refuted") : null),
    cell("Required", { class: "number nowrap" }, row.required ? sentence(row.required) : "\u2013"),
    cell("State", { "data-state": row.state }, el("span.word", unread ? "being read" : row.state), progressOf(row)),
    cell("Rollouts", { class: "number" }, number(row.rollouts)),
    cell("Violations", { class: "number" }, number(row.violations)),
    cell("Last change", { class: "number nowrap" }, timeElement(row.changed)),
  );
}

/** The bound of the first claim; before the end the one that holds now. */
function claimOf(row) {
  if (row.bound) return el(row.refuted ? "s" : "span", sentence(row.bound));
  return row.so_far ? el("span.muted", `so far ${sentence(row.so_far)}`) : "\u2013";
}

/** The name of a campaign, and the way to its page; the server has made the address of bytes that need no escape. */
function linkTo(row) {
  const name = nameElement(row.name, 80);
  return row.href && !UNREADABLE.includes(row.state) ? el("a", { href: row.href }, name) : name;
}

function progressOf(row) {
  if (!row.most_tests || row.tests === null) return null;
  const text = `${count(row.tests)} of at most ${plural(row.most_tests, "test")}`;
  const bar = row.state === "running" ? el("progress", { max: row.most_tests, value: Math.min(row.tests, row.most_tests), "aria-label": text }) : null;
  return [bar, el("span.small", text)];
}

function timeElement(time) {
  if (!time) return "\u2013";
  return el("time", { datetime: new Date(time * 1000).toISOString(), title: utc(time) }, el("span.onscreen", age(time)), el("span.printed", utc(time)));
}

/** "12 s ago", "3 min ago", "5 h ago", "2 days ago". */
function age(time) {
  const seconds = Math.max(0, Date.now() / 1000 + index.skew - time);
  for (const [length, unit] of [[86_400, "day"], [3600, "h"], [60, "min"]]) {
    const number = Math.floor(seconds / length);
    if (number) return `${unit === "day" ? plural(number, unit) : `${number} ${unit}`} ago`;
  }
  return `${Math.floor(seconds)} s ago`;
}

/** Write the ages again, which change by themselves. */
function drawAges() {
  for (const each of document.querySelectorAll("#campaigns time")) {
    const text = age(Date.parse(each.dateTime) / 1000);
    const shown = each.firstElementChild;
    if (shown.textContent !== text) shown.textContent = text;
  }
}

// Input of the reader --------------------------------------------------------------------------------------------------

function choose(changed) {
  Object.assign(index.choices, changed);
  const different = Object.entries(index.choices).filter(([key, value]) => value !== START[key]);
  // In the address, so that the way back from a campaign leads to the same rows.
  history.replaceState(null, "", different.length ? `#${new URLSearchParams(different)}` : location.pathname);
  drawIndex();
}

function readAddress() {
  const found = new URLSearchParams(location.hash.slice(1));
  const allowed = { verdict: [...VERDICTS, "none"], state: STATES, order: COLUMNS.map((each) => each.key) };
  index.choices = { ...START };
  for (const [key, values] of Object.entries(allowed)) if (values.includes(found.get(key))) index.choices[key] = found.get(key);
  index.choices.search = (found.get("search") ?? "").slice(0, 200);
  if (found.has("falling")) index.choices.falling = found.get("falling") === "true";
  else index.choices.falling = index.choices.order === START.order;
}

/** Give the controls the values of the choices; morph leaves what the reader typed. */
function fillControls() {
  const form = document.querySelector("[data-choices]");
  if (!form) return;
  const { verdict, state, search, order, falling } = index.choices;
  Object.assign(form.elements.verdict, { value: verdict });
  Object.assign(form.elements.state, { value: state });
  Object.assign(form.elements.order, { value: `${order} ${falling ? "down" : "up"}` });
  if (form.elements.search.value !== search) form.elements.search.value = search;
}

function onChoice({ target }) {
  if (!target.closest("[data-choices]")) return;
  if (target.name === "order") {
    const [order, direction] = target.value.split(" ");
    choose({ order, falling: direction === "down" });
  } else choose({ [target.name]: target.value });
  fillControls();
}

function onOrder({ target }) {
  const button = target.closest("[data-order]");
  if (button === null) return;
  const column = COLUMNS.find((each) => each.key === button.dataset.order);
  const again = column.key === index.choices.order;
  choose({ order: column.key, falling: again ? !index.choices.falling : Boolean(column.falling) });
  fillControls();
}

function onReset(event) {
  event.preventDefault();
  choose({ ...START });
  fillControls();
}

// Changes --------------------------------------------------------------------------------------------------------------

function takeChanges(found) {
  if (found.whole) index.rows.clear();
  for (const row of found.rows) index.rows.set(row.path, row);
  const { stamp, folder, start, unread, more } = found;
  Object.assign(index, { stamp, folder, start, unread, more, skew: found.now - Date.now() / 1000 });
}

/** Ask for changes again and again; a page that nobody sees asks for nothing. */
async function poll(pause = POLL) {
  let next = index.unread ? SOON : POLL;
  if (!document.hidden) {
    try {
      // Polled: a browser opens six connections to a host, which streams of an index and live pages would use up.
      const answer = await fetch(`campaigns.json?${new URLSearchParams({ seen: index.stamp })}`);
      if (!answer.ok) throw new Error(answer.status);
      if (answer.status === 200) takeChanges(await answer.json());
      const changed = answer.status === 200 || index.connection === "lost";
      index.connection = "live";
      if (changed) drawIndex();
      else drawAges();
      next = index.unread ? SOON : POLL;
    } catch {
      index.connection = "lost";
      next = Math.min(2 * pause, LONGEST_POLL);
      drawIndex();
    }
  }
  setTimeout(() => poll(next), next);
}

document.addEventListener("DOMContentLoaded", () => {
  takeChanges(JSON.parse(document.getElementById("story").textContent));
  readAddress();
  drawIndex();
  fillControls();
  document.addEventListener("input", onChoice);
  document.addEventListener("click", onOrder);
  document.addEventListener("click", ({ target }) => target.dataset?.copy !== undefined && copy(target));
  document.addEventListener("reset", onReset);
  document.addEventListener("submit", (event) => event.preventDefault());
  window.addEventListener("hashchange", () => (readAddress(), drawIndex(), fillControls()));
  setTimeout(poll, index.unread ? SOON : POLL);
});

// A campaign that has not ended: what holds now, what was tested so far, and the event stream of its page.

const [RETRY, LONGEST_RETRY] = [1000, 15_000]; // milliseconds

/** What is proven so far and what is expected at the end, as a table of two rows, and how much of the work is done. */
function holdingSection({ live: found, state }) {
  if (found === null) return null;
  const colours = [found.verdict, found.ahead];
  const cell = (text, k, row) => el("td", { "data-label": found.head[k], "data-verdict": k === found.head.length - 1 ? colours[row] : null }, sentence(text));
  const line = ([name, ...cells], row) => el("tr", el("th", { scope: "row" }, name), cells.map((text, k) => cell(text, k + 1, row)));
  const percent = Math.floor(100 * found.share);
  return el(
    "section#holding",
    { "aria-labelledby": "holds-now" },
    el("h2#holds-now", state === "running" ? "What holds now" : "What held when it stopped"),
    el(
      "table.holding",
      el("thead", el("tr", found.head.map((head) => el("th", { scope: "col" }, head)))),
      el("tbody", found.rows.map(line)),
    ),
    el("progress", { max: 100, value: percent, "aria-label": found.bar }),
    el("p.muted", found.bar),
    el("p", sentence(found.reason)),
    found.violations ? el("p", { class: found.violated ? "bad" : null }, sentence(found.violations)) : null,
  );
}

/** The assumptions that data were compared with so far, the refuted ones first. */
function testedSection({ live: found }) {
  if (found === null || found.tested.length === 0) return null;
  const groupOf = (each) => (each.status !== "refuted" ? "passed" : found.others.includes(each.id) ? "further" : "refuted");
  const [refuted, further, passed] = ["refuted", "further", "passed"].map((group) => found.tested.filter((each) => groupOf(each) === group));
  return el(
    "section#tested",
    el("h2", "Assumptions tested so far"),
    refuted.length ? el("div.refuted", { role: "alert" }, el("p.shout", `REFUTED: ${plural(refuted.length, "assumption")}`), el("p", found.then), definitions("", refuted.map(testedRow))) : null,
    testedGroup("refuted", further, " refuted", ", on which the first claim does not rest"),
    testedGroup("not refuted", passed, " not refuted so far", ", which is not evidence for them"),
  );
}

function testedGroup(status, list, label, meaning) {
  if (list.length === 0) return null;
  const names = list.map((each) => each.title || each.id).join("; ");
  return el(
    "details.group",
    { "data-status": status },
    el("summary", el("span.status", `${list.length}${label}`), el("span.muted", `${meaning}: ${sentence(names)}`)),
    definitions("", list.map(testedRow)),
  );
}

function testedRow(each) {
  return [[sentence(each.title || each.id, 200), el("br"), el("code.muted", short(each.id))], sentence(each.detail)];
}

/** The line at the top: whether the page follows, and whether there is anything to follow. */
function statusText(connection, state) {
  if (connection === "ended" || state === "finished") return "the campaign has finished";
  if (connection === "connecting") return "connecting";
  const stopped = state === "stopped" && `stopped: no process runs this campaign${page.report.resume && `; continue with: ${page.report.resume}`}`;
  if (connection === "live") return stopped || "live";
  return stopped || "connection lost, retrying";
}

function statusLine() {
  const state = page.report?.state ?? "running";
  const time = page.updated === null ? null : new Date(page.updated).toTimeString().slice(0, 8);
  const text = statusText(page.connection, state);
  const shown = state === "running" ? page.connection : state === "stopped" ? "stopped" : "ended";
  const down = shown === "live" ? (page.report?.link?.down_for ?? null) : null;
  const parts = [text, time && shown !== "ended" && `updated at ${time}`, down !== null && `the link to the router has been down for ${duration(Math.round(down))}`];
  const status = { role: "status", "data-connection": page.connection === "connecting" ? "connecting" : shown, "data-link": down === null ? null : "down" };
  return el("p#live", status, parts.filter(Boolean).join("; "));
}

function setConnection(state) {
  page.connection = state;
  if (page.report !== null) morph(document.getElementById("live"), statusLine());
}

/** A finished campaign has no further events. */
function end(source) {
  source.close();
  setConnection("ended");
}

/** Follow the event stream. EventSource reconnects by itself, except after an HTTP error: then with growing pauses. */
function follow(wait = RETRY) {
  const source = new EventSource(page.live);
  source.addEventListener("story", (event) => {
    const report = JSON.parse(event.data);
    wait = RETRY;
    page.connection = "live";
    page.updated = Date.now();
    show(report);
    if (report.state === "finished") end(source); // at once: the server ends before the next frame of the screen
  });
  source.addEventListener("fault", (event) => document.getElementById("reading")?.replaceChildren(event.data));
  source.onopen = () => setConnection("live");
  source.onerror = () => {
    setConnection("lost");
    if (source.readyState !== EventSource.CLOSED) return;
    source.close();
    setTimeout(() => follow(Math.min(2 * wait, LONGEST_RETRY)), wait);
  };
}

let waiting = null; // the newest undrawn report data

/** Draw report data at the next frame of the screen, the newest if several wait. */
function show(report) {
  if (waiting === null) requestAnimationFrame(() => ((page.report = waiting), (waiting = null), draw()));
  waiting = report;
}

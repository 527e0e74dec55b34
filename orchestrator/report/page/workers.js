// Sections of the workers and of the output files, with the commands that verify and resume.

function workerSection(report) {
  const { throughput, workers } = report;
  const facts = [
    ["Recorded", plural(allRollouts(report), "rollout")],
    ["Rate over the last active minute", `${num(throughput.rate, 3)} rollouts/s`],
    ["Failed attempts", failureText(throughput)],
    ["Sessions (run and resumes)", count(throughput.sessions)],
    ["First result", utc(throughput.start)],
  ];
  return el(
    "section#workers",
    el("h2", "Workers"),
    definitions(".facts", facts),
    throughput.seconds.length > 1 ? chartFigure("throughput", "Rollouts recorded over time") : null,
    workers.length ? workerTable(report) : el("p.muted", "No worker has joined yet."),
    report.more_workers ? el("p.muted", `and ${plural(report.more_workers, "more worker")} with fewer attempts`) : null,
    report.set_aside.length ? setAsideTable(report.set_aside) : null,
    report.compared.length ? comparedTable(report) : null,
    report.failed_attempts.length ? failureTable(report) : null,
  );
}

function failureText({ failures, system_failures }) {
  return system_failures ? `${count(failures)}, ${count(system_failures)} of them in the system` : count(failures);
}

/** The latest failed attempts; kind is null in databases that do not tell. */
function failureTable({ failed_attempts, throughput }) {
  const shown = failed_attempts.length < throughput.failures ? `the latest ${failed_attempts.length} of ${count(throughput.failures)}` : plural(failed_attempts.length, "failed attempt");
  const kind = (value) => (value === "system" ? el("strong.bad", "system") : value === null ? num(null) : short(value, 20));
  const rows = failed_attempts.map((each) => [
    nameElement(each.rollout, 60),
    count(each.attempt),
    nameElement(each.worker, 60),
    kind(each.kind),
    nameElement(each.reason, 120),
    utc(each.ended),
  ]);
  return el("details", el("summary", `Failed attempts: ${shown}`), table(["Rollout", "#Attempt", "Worker", "Kind", "Reason", "#Ended"], rows));
}

/** Workers and hosts that were set aside. */
function setAsideTable(found) {
  const rows = found.map((each) => [
    short(each.kind, 20),
    nameElement(each.name, 60),
    count(each.times),
    each.for_good ? el("strong.bad", "for good") : "for a pause",
    utc(each.last),
    nameElement(each.reason, 120),
  ]);
  return el("details", el("summary", `Set aside: ${count(found.length)} of the workers and hosts`), table(["Kind", "Name", "#Times", "How long", "#Last", "Reason"], rows));
}

/** Results that were compared with others of their rollouts. */
function comparedTable({ compared, compared_results }) {
  const shown = compared.length < compared_results ? `${compared.length} of ${count(compared_results)}, the latest` : plural(compared.length, "result");
  const rows = compared.map((each) => [
    each.kind === "outvoted" ? el("strong.bad", "outvoted") : short(each.kind, 20),
    nameElement(each.rollout, 60),
    count(each.attempt),
    nameElement(each.worker, 60),
    el("code", short(each.sha256, 12)),
    utc(each.at),
  ]);
  return el("details", el("summary", `Compared results: ${shown}`), table(["Kind", "Rollout", "#Attempt", "Worker", "sha256", "#Time"], rows));
}

/**
 * A page of a campaign under way has ages, and with the feed of its run states and heartbeats; one that is stopped or
 * finished, and a report, have times.
 */
function workerTable(report) {
  const running = report.updated !== null && report.state === "running";
  const live = running && report.workers.some((each) => each.heartbeat !== null);
  const heads = ["Worker", "Host", live && "State", "#Rollouts", "#Failures", "#Busy time", "#CPU time", "#Last result", live && "#Heartbeat", live && "Current rollout"];
  const row = (each) => [
    nameElement(each.name, 60),
    nameElement(each.host, 60),
    live && el("span.worker", { "data-state": each.state }, short(each.state, 20)),
    count(each.rollouts),
    each.failures ? el("strong.bad", count(each.failures)) : "0",
    duration(each.busy_seconds),
    duration(each.cpu_seconds),
    running ? ago(each.last, report.updated) : utc(each.last),
    live && ago(each.heartbeat, report.updated),
    live && (each.rollout === null ? num(null) : nameElement(each.rollout, 60)),
  ];
  const visibleCells = (list) => list.filter((value, k) => heads[k] !== false);
  return table(visibleCells(heads), report.workers.map((each) => visibleCells(row(each))));
}

function drawThroughput(throughput) {
  const host = document.getElementById("throughput");
  if (!host) return;
  const last = throughput.seconds.at(-1);
  const [size, unit] = last < 180 ? [1, "s"] : last < 10_800 ? [60, "min"] : [3600, "h"];
  chart(
    host,
    { height: 170, x: `time since the first result (${unit})`, y: { label: "rollouts" }, series: [{ label: "recorded", colour: "blue" }] },
    [throughput.seconds.map((value) => value / size), throughput.recorded],
  );
}

function outputSection(report) {
  const finished = report.state === "finished";
  const rows = [
    ["Certificate", finished ? el("a", { href: "certificate.json" }, "certificate.json") : null],
    ["Trajectories", "trajectories/, one MCAP file per rollout or batch"],
    ["Tests, results and bounds", "campaign.db (SQLite)"],
    ["Verify the certificate against these files", finished ? commandLine(verifyCommand()) : null],
    ["Resume the campaign", report.resume && !finished ? commandLine(report.resume) : null],
  ];
  return el("section#output", el("h2", "Output files"), definitions(".files", rows));
}

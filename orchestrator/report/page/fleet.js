"use strict";
// Who did the work, how fast, with which software, and how to go on.

function fleetSection(story) {
  const { throughput, workers } = story;
  const facts = [
    ["Recorded", plural(story.rollouts, "rollout")],
    ["Rate over the last minute of work", `${num(throughput.rate, 3)} rollouts/s`],
    ["Failed attempts", count(throughput.failures)],
    ["Sessions", count(throughput.sessions)],
    ["First result", utc(throughput.start)],
  ];
  return el(
    "section#workers",
    {},
    el("h2", {}, "Workers"),
    el("dl.facts", {}, facts.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value)))),
    throughput.seconds.length > 1 ? el("figure", {}, el("figcaption", {}, "Rollouts recorded over time"), chartHost("throughput", "Rollouts recorded over time")) : null,
    workers.length ? workerTable(story) : el("p.muted", {}, "No worker is known yet."),
  );
}

/** A live page knows the states and counts from now; a report says when. */
function workerTable(story) {
  const live = story.updated !== null;
  const heads = ["Worker", "Host", live && "State", "#Rollouts", "#Failures", "#Busy", "#CPU", "#Last result", live && "#Heartbeat", live && "Working on"];
  const row = (each) => [
    named(each.name, 60),
    named(each.host, 60),
    live && el("span.worker", { "data-state": each.state }, short(each.state, 20)),
    count(each.rollouts),
    each.failures ? el("strong.bad", {}, count(each.failures)) : "0",
    duration(each.busy_seconds),
    duration(each.cpu_seconds),
    live ? ago(each.last, story.updated) : utc(each.last),
    live && ago(each.heartbeat, story.updated),
    live && (each.rollout === null ? num(null) : named(each.rollout, 60)),
  ];
  const kept = (list) => list.filter((value, k) => heads[k] !== false);
  return table(kept(heads), story.workers.map((each) => kept(row(each))));
}

function drawThroughput(throughput) {
  const host = document.getElementById("throughput");
  if (!host) return;
  const last = throughput.seconds.at(-1);
  const [size, unit] = last < 180 ? [1, "s"] : last < 10_800 ? [60, "min"] : [3600, "h"];
  chart(
    host,
    { height: 170, x: { label: `time since the first result (${unit})`, name: `time (${unit})` }, y: { label: "rollouts" }, series: [{ label: "recorded", colour: "blue" }] },
    [throughput.seconds.map((value) => value / size), throughput.recorded],
  );
}

function softwareSection(story) {
  const versions = Object.entries(story.software);
  return el(
    "section#software",
    {},
    el("h2", {}, "Check it, go on, run it again"),
    el(
      "dl.ways",
      {},
      el("div", {}, el("dt", {}, "Check the certificate against its evidence"), el("dd", {}, el("code", {}, document.body.dataset.live ? "perfbound verify DIR" : "perfbound verify ."))),
      story.resume && story.state !== "finished" ? el("div", {}, el("dt", {}, "Continue the campaign"), el("dd", {}, commandLine(story.resume))) : null,
      el("div", {}, el("dt", {}, "Run"), el("dd", {}, el("code", {}, short(story.run, 120)))),
      versions.length ? el("div", {}, el("dt", {}, "Software"), el("dd", {}, versions.map(([name, version]) => `${short(name, 40)} ${short(version, 40)}`).join(", "))) : null,
    ),
  );
}

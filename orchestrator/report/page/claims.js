// Sections of the claims, their composition and their assumptions; refuted assumptions come first.

/** Status of an assumption -> how the card counts it. */
const STATUS_WORDS = {
  refuted: "refuted",
  "not refuted": "checked and not refuted",
  assumed: "not checked",
  derived: "derived from the file and the recorded data",
};

/** Status of an assumption -> its meaning, in the order of the section. */
const MEANING = {
  refuted: "by the data of this campaign or by derivation",
  "not refuted": "checked against the data of this campaign, which is not evidence for it",
  assumed: "not checked",
  derived: "follows from the campaign file and the recorded data",
  "for further claims": "the first claim does not depend on them",
};

/** Name and state, and the question that the campaign asks. */
function titleSection(report) {
  const system = [`System ${nameText(report.system)}`, report.doc ? `: ${short(report.doc, 300)}` : ""];
  const asks = report.specification === null ? null : [el("strong", "Requirement: "), el("code", short(report.specification, 300)), " "];
  return el(
    "header#title",
    el("p.kind", ["perfbound campaign", ...whenAndWho(report)].join(" \u00b7 ")),
    el("h1", nameElement(report.name, 120), el("span.state", { "data-state": report.state }, short(report.state, 20))),
    el("p.question", asks, `from ${startsText(report)}${spaceText(report)}.`),
    el("p.question", el("strong", system[0]), system[1]),
    report.required ? el("p.question", el("strong", "Asked: "), sentence(report.required)) : null,
  );
}

/** Of which starts of the space the first claim is. */
function startsText(report) {
  if (report.problems.some(isListed)) return "each of ";
  return report.problems.some(drawsStarts) ? "starts that are drawn with " : "every start with ";
}

/** When a campaign ended, and who ran it. */
function whenAndWho({ provenance: from, state }) {
  const ended = state === "finished" && from?.ended != null ? [`ended ${utc(from.ended)}`] : [];
  return from?.accounts.length ? [...ended, `run by ${from.accounts.map((each) => short(each, 40)).join(", ")}`] : ended;
}

function nameText(name) {
  return short(name, 60);
}

/** The campaign in numbers, and where its evidence comes from. */
function aboutSection(report) {
  const from = report.provenance;
  const took = from?.started != null && from?.ended != null ? ` (${duration(from.ended - from.started)})` : "";
  const facts = [
    ["System", nameElement(report.system, 60)],
    ["Code", report.code === null ? null : short(report.code, 300)],
    ["Specification", report.specification === null ? null : el("code", short(report.specification, 300))],
    ["Starting conditions", spaceText(report)],
    ["Horizon", `${num(report.horizon)} s`],
    ["Robustness clipped to", report.clip === null ? null : sentence(`[${num(report.clip[0])}, ${num(report.clip[1])}]`).replace("[-", "[\u2212")],
    ["Risk weight r", report.risk_weight === null ? null : num(report.risk_weight)],
    ["Seed", report.seed],
    ["Rollouts", rolloutsText(report)],
    ["Run by", from?.accounts.length ? from.accounts.map((each) => short(each, 40)).join(", ") : null],
    ["Time", from?.started == null ? null : `${utc(from.started)}${from.ended === null ? "" : ` to ${utc(from.ended)}${took}`}`],
    ["Sessions", report.throughput.sessions > 1 ? `${count(report.throughput.sessions)}, the first one and its continuations` : null],
    ["Machine of the orchestrator", from?.hosts.length ? [...from.hosts, ...from.platforms].map((each) => short(each, 60)).join(", ") : null],
    ["Software", Object.entries(report.software).map(([name, version]) => `${short(name, 40)} ${short(version, 40)}`).join(", ")],
    ["Run", el("code", short(report.run, 120))],
  ];
  return el(
    "section#about",
    el("h2", "About this campaign"),
    definitions(".facts", facts),
    from === null ? null : el("details.group", el("summary", "Campaign file", el("span.muted", ` all keys that differ from their defaults; sha256 ${short(from.digest, 64)}`)), el("pre", visible(from.file).slice(0, 20_000))),
  );
}

/** The rollouts behind the bounds and of the checks after the campaign. */
function allRollouts(report) {
  return Object.values(report.closing_rollouts).reduce((sum, each) => sum + each, report.rollouts);
}

/** "1,013: 480 for the bound, 513 of the spot check, 20 of the recheck". */
function rolloutsText(report) {
  const closing = Object.entries(report.closing_rollouts);
  if (!closing.length) return count(report.rollouts);
  return `${count(allRollouts(report))}: ${[`${count(report.rollouts)} for the bound`, ...closing.map(([name, each]) => `${count(each)} of the ${words(name)}`)].join(", ")}`;
}

function spaceText(report) {
  const starts = report.problems.find(isListed)?.surfaces[0].points.length;
  // Beside drawn starts a search may choose disturbances, which no claim is for.
  const chosen = report.problems.some(drawsStarts) ? report.disturbances.map(({ name }) => name) : [];
  const box = axesOf(report, readAxes(report)).filter(({ name }) => !chosen.includes(name)).map(({ name, low, high, unit }) => `${short(name, 24)} ${num(low)} to ${quantity(high, unit)}`);
  const region = report.where === null ? "" : `, where ${short(report.where, 300)}`;
  return (starts ? `${plural(starts, "start")} with ` : "") + [...box, ...longInputs(report.axes)].join(", ") + region;
}

/** The verdict, the refutation, the claim in words and as a formula, the other claims. */
function claimSection(report) {
  const [first, ...others] = report.claims;
  const formula = first ? formulaOf(first) : null;
  const repeatsTable = report.live !== null && report.problems.length === 1; // `holdingSection` has the one bound
  return el(
    "section#verdict",
    { "aria-label": "Verdict and claim" },
    verdictCard(report),
    refutation(report),
    counterexample(report),
    repeatsTable ? null : el("p.kind", claimHeading(report)),
    repeatsTable ? null : el("p.claim#claim", sentence(first ? first.sentence : report.now)),
    formula && el("div.formula", formula),
    first ? el("p.muted", claimBasis(first, unitText(report.problems[0]?.unit))) : null,
    first ? first.notes.map((note) => el("p.muted", sentence(note))) : null,
    first && report.verdict === null ? worstPicture(report) : null, // else it is in the card
    report.violations && !report.counterexample && !report.verdict ? el("p", el("a", { href: "#counterexamples" }, `${plural(report.violations, "rollout")} violated the specification.`)) : null,
    others.length ? otherClaims(others) : null,
  );
}

/** The worst rollout with its limit, which a reader looks for first. */
function worstPicture(report) {
  const data = worstScene(report);
  if (!data?.traces.length) return null;
  const { name, unit } = limitedColumn(data);
  const test = el("button", { "data-select": `${data.problem}:${data.test}` }, `Show test ${count(data.test)}`);
  return el("div.worst-picture", chartFigure("worst-curve", `The worst rollout: ${withUnit(name, unit)} against time`), el("p", test));
}

/** What stands above the words of the first claim: a violation or refutation is the verdict, and not the claim. */
function claimHeading({ claims, verdict }) {
  if (!claims.length) return "Bounds so far";
  if (claims[0].refuted.length) return "The refuted claim, in the words of the certificate";
  if (verdict?.word === "VIOLATED") return "The bound that was computed too, which is not the verdict";
  return claims.length > 1 ? "First claim, chosen before the campaign" : "The claim in the words of the certificate";
}

/** The answer to the question of the campaign: what was shown, how sure, on what it rests, and what to do next. */
function verdictCard(report) {
  const { verdict: found } = report;
  if (found === null) return null;
  // What is refuted, and what a violation makes pointless, stands with the claim below.
  const claim = refutedOf(report).length || found.by_rollouts !== null || report.claims[0].vacuous ? [] : [found.claim];
  // What holds without a kernel comes before what rests on its constants.
  const anyway = found.rests_on && found.anyway ? [found.anyway] : [];
  const [answer, ...more] = found.word === "SHOWN" ? [...anyway, ...claim, ...found.reasons] : [...found.reasons, ...claim];
  const rows = [
    ["In detail", more.map((text) => el("p", withTerms(text)))],
    ["What refutes it", refutedOf(report).map((each) => el("p", withTerms(each.detail)))],
    ["Rollouts", rolloutCount(report)],
    ["Repeat the worst", found.command ? commandLine(found.command) : null],
    ["How sure", found.sure.map((text) => el("p", withTerms(text)))],
    ["What holds anyway", found.anyway && !anyway.length ? el("p", withTerms(found.anyway)) : null],
    ["What it rests on", restsOn(report)],
    ["What to do next", nextSteps(report)],
  ];
  return el(
    "div.card#answer",
    { "data-verdict": found.word, "data-rests": found.rests_on ? "" : null },
    el("p.word", found.word, found.rests_on ? el("span.rests", `, rests on ${found.rests_on}`) : null),
    el("p.answer", withTerms(answer)),
    el(
      "div.beside",
      worstPicture(report),
      el("dl.parts", rows.filter(([, value]) => value !== null && value.length !== 0).map(([name, value]) => el("div", el("dt", name), el("dd", value)))),
    ),
  );
}

/** Quantities of claims about a mean. */
const OF_MEANS = ["rho_star", "expected_robustness", "mean", "risk"];
/** In the sentence of the spot check on violations. */
const FRESH = "at fresh starts violate the specification";

/** How many rollouts violate the specification, and what that number is not. */
function rolloutCount(report) {
  const { verdict: found, claims: [first] } = report;
  if (!found.count) return null;
  const chosen = report.violations && report.problems.some((problem) => problem.drawn === null);
  const mean = found.word === "SHOWN" && OF_MEANS.includes(first.quantity);
  return [
    el(
      "p",
      report.violations ? el("a", { href: "#counterexamples" }, sentence(found.count)) : [found.word === "SHOWN" ? null : "No violation was found: ", sentence(found.count)],
      chosen ? " Part of them are where the margin seemed worst, so this is no failure rate." : null,
      mean ? " What is shown is about means: single rollouts may be worse." : null,
    ),
    report.checks.filter((each) => each.includes(FRESH)).map((each) => el("p", sentence(each))),
  ];
}

/** What no data of a campaign can test of a claim, in the order of how much depends on it. */
const FIRST_OF_ALL = ["simulator_is_the_system", "rkhs_norm", "kernel", "noise_scale"];

/** The assumptions of the first claim: how many have which status, and those that nothing checked. */
function restsOn(report) {
  if (report.verdict.by_rollouts !== null) {
    const chance = report.verdict.by_rollouts === "certain" ? "" : ", which must be independent of each other";
    const outside = report.assumptions.find((each) => each.id === "simulator_is_the_system")?.title ?? "the real system behaves like the simulator";
    const borders = report.assumptions.some((each) => each.id === "borders") ? ", on how their time stamps at borders of windows are read" : "";
    return [el("p", `On the rollouts alone${chance}${borders}, and on what no rollout can check: that ${outside.charAt(0).toLowerCase()}${outside.slice(1)}.`)];
  }
  if (report.claims[0].vacuous) return [el("p", "On nothing: the bound holds without any rollout.")];
  const mine = report.assumptions.filter((each) => report.claims[0].assumptions.includes(each.id));
  const of = (status) => mine.filter((each) => each.status === status);
  const counts = Object.entries(STATUS_WORDS).map(([status, text]) => [of(status).length, text]).filter(([number]) => number);
  const rank = ({ id }) => (FIRST_OF_ALL.indexOf(id.split("/")[0]) + FIRST_OF_ALL.length + 1) % (FIRST_OF_ALL.length + 1);
  const broken = of("refuted").length > 0; // then the others do not matter
  const titles = broken ? [] : [...new Map(of("assumed").sort((a, b) => rank(a) - rank(b)).map((each) => [each.title + each.numbers, [each.title, each.numbers]])).values()];
  return [
    el("p", el("a", { href: "#assumptions" }, plural(mine.length, "assumption")), `: ${counts.map(([number, text]) => `${number} ${text}`).join(", ")}.${titles.length ? " Not checked, so you must judge:" : ""}`),
    titles.length ? el("ul.judge", titles.map(([title, numbers]) => el("li", withTerms(short(title, 90)), numbers ? el("span.muted", ` (${short(numbers, 120)})`) : null))) : null,
  ];
}

/** The advice of a verdict; after a claim that is shown, how to check it. */
function nextSteps(report) {
  const advice = report.verdict.advice.map((text) => el("p", withCommands(text)));
  if (advice.length || report.verdict.word === "NOT SHOWN") return advice;
  if (report.verdict.word === "VIOLATED") return [el("p", "Look at the ", el("a", { href: "#counterexamples" }, "counterexamples"), "; change the system, or the starts from which it may operate; then run a new campaign.")];
  return [el("p", "Judge the assumptions that nothing checked. Then let another person verify that the claim follows from the evidence:"), commandLine(verifyCommand())];
}

function verifyCommand() {
  return `perfbound verify ${document.body.dataset.live ? "DIR" : "."}`; // a report may be moved with its run directory
}

/** A sentence with its commands and keys, which stand between backticks, as code. */
function withCommands(text) {
  return text.split("`").map((part, place) => (place % 2 ? el("code", short(part, 300)) : sentence(part)));
}

function claimBasis(claim, unit) {
  const rule = ["single", "every"].includes(claim.rule) ? "" : `, ${words(claim.rule)} rule`;
  const clipped = claim.clipped ? `\u03c1 is the robustness clipped to [${claim.clipped.map((end) => num(end)).join(", ").replaceAll("-", "\u2212")}]. ` : "";
  return `${unit && `Bound in ${unit}. `}${clipped}Method ${words(claim.method)}${rule}. Depends on ${plural(claim.assumptions.length, "assumption")}.`;
}

/** The rollout that ended the campaign, its test and the command that repeats it. */
function counterexample({ counterexample: found }) {
  if (found === null) return null;
  return el(
    "div.refuted#counterexample",
    el("p.shout", "COUNTEREXAMPLE"),
    ...found.sentences.map((each) => el("p", sentence(each, 1000))),
    el("p", el("button", { "data-select": `${found.problem}:${found.test}` }, "Show its trajectory")),
    commandLine(found.command),
  );
}

/** The refuted assumptions of the first claim; without a claim, all that are refuted. */
function refutedOf(report) {
  const broken = report.assumptions.filter((each) => each.status === "refuted");
  const first = report.claims[0];
  return first ? broken.filter((each) => first.refuted.includes(each.id) || first.assumptions.includes(each.id)) : broken;
}

/** The box about what is refuted; the card of a verdict has it in its place. */
function refutation(report) {
  if (report.verdict !== null) return null;
  const broken = refutedOf(report);
  const missing = (report.claims[0]?.refuted ?? []).filter((id) => !broken.some((each) => each.id === id));
  const explains = (problem) => broken.some((each) => each.id.endsWith(`/${problem.name}`));
  const stopped = report.problems.filter((each) => each.stopped_by === "refuted" && !explains(each));
  const number = broken.length + missing.length;
  if (number + stopped.length === 0) return null;
  const [subject, depend] = report.claims.length ? ["claim", "depends"] : ["bounds", "depend"];
  const those = number === 1 ? "an assumption that is" : "assumptions that are";
  return el(
    "div.refuted#refuted",
    { role: "alert" },
    el("p.shout", `REFUTED${number ? `: ${plural(number, "assumption")}` : ""}. Do not rely on the ${subject} below.`),
    number ? el("p", `The ${subject} ${depend} on ${those} refuted ${MEANING.refuted}.`) : null,
    definitions("", [...broken.map(assumptionRow), ...missing.map((id) => [nameElement(id), "no detail recorded"])]),
    stopped.map((each) => el("p", `The data of ${words(each.name)} contradict its assumptions: its bound is invalid.`)),
  );
}

/** A title in plain words with the id in grey, and the finding. */
function assumptionRow(each) {
  return [[el("span.title", short(each.title, 120)), el("span.id", nameElement(each.id))], sentence(each.detail)];
}

function otherClaims(claims) {
  const broken = (claim) => (claim.refuted.length ? el("strong.bad", claim.refuted.length) : 0);
  const rows = claims.map((claim) => [
    [sentence(claim.sentence), ...claim.notes.map((note) => el("p.muted", sentence(note)))], words(claim.method), words(claim.rule), claim.assumptions.length, broken(claim),
  ]);
  return el(
    "details.more",
    { open: true },
    el("summary", plural(claims.length, "further claim")),
    table(["Claim", "Method", "Rule", "#Assumptions", "#Refuted"], rows),
    el("p.muted", "Each claim holds with its own probability; if you pick the best claim afterwards, its failure probability is the sum of all their failure probabilities."),
  );
}

/** The assumptions of the first claim by status, then those of further claims only. */
function assumptionSection(report) {
  const [first] = report.claims;
  const groupOf = (each) => (!first || first.assumptions.includes(each.id) ? each.status : "for further claims");
  return el(
    "section#assumptions",
    { hidden: report.assumptions.length === 0 },
    el("h2", "Assumptions"),
    Object.keys(MEANING).map((group) => assumptionGroup(group, report.assumptions.filter((each) => groupOf(each) === group))),
  );
}

function assumptionGroup(group, list) {
  if (list.length === 0) return null;
  const row = (each) => assumptionRow(each.status === group ? each : { ...each, detail: `${each.status}: ${each.detail}` });
  return el(
    "details.group",
    { open: group === "refuted", "data-status": group },
    el("summary", el("span.status", `${list.length} ${group}`), el("span.muted", ` ${MEANING[group]}`)),
    definitions("", list.map(row)),
  );
}

/** The effect of a subtracted term on the bound. */
function change(term) {
  return (term < 0 ? "+" : "") + outward(-term, ">="); // pointwise rule: a gap term below zero raises the bound
}

/** From the nominal bound to the bound of the claim, term by term. */
function compositionSection(report) {
  const found = report.composition;
  if (!found) return el("section#composition", { hidden: true });
  const { nominal_bound: nominal, gap_term: gap, risk_term: risk, bound } = found;
  const unit = unitText(report.problems[0]?.unit);
  const rows = [
    ["Nominal bound \u03c1\u0303", 0, nominal, "whole", outward(nominal, ">=")],
    ["minus gap term", nominal - gap, nominal, "less", change(gap)],
    ["minus risk term", nominal - gap - risk, nominal - gap, "less", change(risk)],
    ["Bound \u2113", 0, bound, "whole", outward(bound, ">=")],
  ];
  const range = extent(rows.flatMap(([, from, to]) => [from, to]), report.clip ?? [], [0]);
  const marks = [[0, "0", "zero"], ...(report.clip ?? []).map((value) => [value, `clip ${num(value)}`, "clip"])];
  return el(
    "section#composition",
    el("h2", "How the bound is composed"),
    el("div.bars.waterfall", rows.map(([label, from, to, kind, text]) => barRow(label, [[from, to, kind]], text.replace("-", "\u2212"), range, marks))),
    barScale(range, marks),
    el("p.muted", `All numbers${unit && ` in ${unit}`}, rounded to the safe side; ${words(found.rule)} rule.`),
  );
}


/** Spot check and recheck after the campaign. */
function checkSection(report) {
  const line = (text) => el(text.includes("REFUTED") ? "li.bad" : "li", text);
  return el(
    "section#checks",
    { hidden: report.checks.length === 0 },
    el("h2", "After the campaign"),
    el("ul", report.checks.map(line)),
  );
}

/** A row: label, bars with marks, number. */
function barRow(label, bars, text, range, marks) {
  return [el("span", label), barPicture(bars, range, marks), el("span.value", text)];
}

/** Bars [from, to, kind] and marks [at, label, kind] over a range. */
function barPicture(bars, range, marks) {
  const at = (value) => 4 + (992 * (value - range[0])) / (range[1] - range[0] || 1);
  const bar = ([from, to, kind]) =>
    svg("rect", { class: kind, x: at(Math.min(from, to)), width: Math.max(2, Math.abs(at(to) - at(from))), y: kind === "mean" ? 3 : 5, height: kind === "mean" ? 14 : 10 });
  const mark = ([value, , kind]) => svg("line", { class: kind, x1: at(value), x2: at(value), y1: 0, y2: 20 });
  return svg("svg", { viewBox: "0 0 1000 20", preserveAspectRatio: "none", "aria-hidden": "true" }, ...bars.map(bar), ...marks.map(mark));
}

/** The names of the marks below the bars, from left to right. */
function barScale(range, marks) {
  const names = [...marks].sort((a, b) => a[0] - b[0]).map(([, label, kind]) => legendItem(`key.${kind}`, label));
  return el("ul.legend", el("li", `scale ${num(range[0])} to ${num(range[1])}`), names);
}

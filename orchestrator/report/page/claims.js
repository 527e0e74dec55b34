// Sections of the claims, their composition and their assumptions; refuted assumptions come first.

/** Status of an assumption -> its meaning, in the order of the section. */
const MEANING = {
  refuted: "by the data of this campaign or by derivation",
  "not refuted": "checked against the data of this campaign, which is not evidence for it",
  assumed: "not checked",
  derived: "follows from the campaign file and the recorded data",
  "for further claims": "the first claim does not depend on them",
};

function titleSection(report) {
  const facts = [
    ["System", nameElement(report.system, 60)],
    ["Code", report.code === null ? null : short(report.code, 300)],
    ["Specification", report.specification === null ? null : el("code", short(report.specification, 300))],
    ["Starting conditions", spaceText(report)],
    ["Horizon", `${num(report.horizon)} s`],
    ["Robustness clipped to", report.clip === null ? null : `[${num(report.clip[0])}, ${num(report.clip[1])}]`],
    ["Risk weight r", report.risk_weight === null ? null : num(report.risk_weight)],
    ["Seed", report.seed],
    ["Rollouts", count(report.rollouts)],
  ];
  return el(
    "header#title",
    el("p.kind", "perfbound campaign"),
    el("h1", nameElement(report.name, 120), el("span.state", { "data-state": report.state }, short(report.state, 20))),
    report.doc ? el("p.muted", short(report.doc, 300)) : null,
    definitions(".facts", facts),
  );
}

function spaceText(report) {
  const starts = report.problems.find(isListed)?.surfaces[0].points.length;
  const box = report.axes.map(({ name, low, high, unit }) => `${short(name, 24)} from ${num(low)} to ${quantity(high, unit)}`);
  const region = report.where === null ? "" : `, where ${short(report.where, 300)}`;
  return (starts ? `${plural(starts, "start")} with ` : "") + box.join(", ") + region;
}

/** The refutation, the claim in words, the other claims. */
function claimSection(report) {
  const [first, ...others] = report.claims;
  return el(
    "section#verdict",
    { "aria-label": "Verdict and claim" },
    verdictCard(report),
    refutation(report),
    counterexample(report),
    el("p.kind", first ? (others.length ? "First claim, chosen before the campaign" : "Claim") : "Bounds so far"),
    el("p.claim#claim", sentence(first ? first.sentence : report.now)),
    first ? first.notes.map((note) => el("p.muted", sentence(note))) : null,
    first ? el("p.muted", claimBasis(first, unitText(report.problems[0]?.unit))) : null,
    report.violations && !report.counterexample && !report.verdict ? el("p", el("a", { href: "#counterexamples" }, `${plural(report.violations, "rollout")} violated the specification.`)) : null,
    others.length ? otherClaims(others) : null,
  );
}

/** The answer to the question of the campaign, why, what would help, and how many rollouts violate the specification. */
function verdictCard({ verdict: found }) {
  if (found === null) return null;
  const answer = found.word === "SHOWN" ? [found.claim, ...found.reasons] : [...found.reasons, found.claim];
  const violating = el("a", { href: "#counterexamples" }, sentence(found.count));
  return el(
    "div.card#answer",
    { "data-verdict": found.word },
    el("p.word", found.word),
    answer.map((text, place) => el(place === 0 ? "p.answer" : "p", sentence(text))),
    found.advice.map((text) => el("p", el("strong", "What would help: "), withCommands(text))),
    found.count ? el("p", found.command ? violating : sentence(found.count)) : null,
    found.command ? commandLine(found.command) : null,
  );
}

/** A sentence with its commands and keys, which stand between backticks, as code. */
function withCommands(text) {
  return text.split("`").map((part, place) => (place % 2 ? el("code", short(part, 300)) : sentence(part)));
}

function claimBasis(claim, unit) {
  const rule = ["single", "every"].includes(claim.rule) ? "" : `, ${words(claim.rule)} rule`;
  return `${unit && `Bound in ${unit}. `}Method ${words(claim.method)}${rule}. Depends on ${plural(claim.assumptions.length, "assumption")}.`;
}

/** The rollout that ended the campaign, its test and the command that repeats it. */
function counterexample({ counterexample: found }) {
  if (found === null) return null;
  return el(
    "div.refuted#counterexample",
    el("p.shout", "COUNTEREXAMPLE"),
    el("p", sentence(found.sentence, 1000)),
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

function refutation(report) {
  const broken = refutedOf(report);
  const missing = (report.claims[0]?.refuted ?? []).filter((id) => !broken.some((each) => each.id === id));
  const stopped = report.problems.filter((each) => each.stopped_by === "refuted");
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

function assumptionRow(each) {
  return [nameElement(each.id), sentence(each.detail)];
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

"use strict";
// What is claimed, what it rests on, and how it comes about. What is refuted is said first.

const GROUPS = ["refuted", "not refuted", "assumed", "derived"];
const MEANING = {
  refuted: "by this campaign\u2019s own data or by derivation",
  "not refuted": "tested against this campaign\u2019s data, which is not evidence for it",
  assumed: "not tested",
  derived: "follows from the campaign",
};
const LONGEST_SENTENCE = 1200;

/** Name, state and what was tested. */
function titleSection(story) {
  const facts = [
    ["System", named(story.system, 60)],
    ["Specification", story.specification === null ? null : el("code", {}, short(story.specification, 300))],
    ["Starting conditions", spaceWords(story)],
    ["Horizon", `${num(story.horizon)} s`],
    ["Robustness clipped to", story.clip === null ? null : `[${num(story.clip[0])}, ${num(story.clip[1])}]`],
    ["Risk weight r", num(story.risk_weight)],
    ["Seed", String(story.seed)],
    ["Rollouts", count(story.rollouts)],
  ];
  const shown = facts.filter(([, value]) => value !== null && value !== "");
  return el(
    "header#title",
    {},
    el("p.kind", {}, "perfbound campaign"),
    el("h1", {}, named(story.name, 120), el("span.state", { "data-state": story.state }, short(story.state, 20))),
    story.doc ? el("p.muted", {}, short(story.doc, 300)) : null,
    el("dl.facts", {}, shown.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value)))),
  );
}

function spaceWords(story) {
  const starts = story.problems.find((each) => each.surface?.points.length)?.surface.points.length;
  const box = story.axes.map((axis) => {
    const range = `${num(axis.low)} to ${quantity(axis.high, axis.unit)}`;
    return `${short(axis.name, 24)} ${range}`;
  });
  return (starts ? `${plural(starts, "start")} listed: ` : "") + box.join(", ");
}

/** The refutation, the claim in words, the other claims. */
function claimSection(story) {
  const [first, ...others] = story.claims;
  return el(
    "section#verdict",
    { "aria-label": "Claim" },
    refutation(story),
    el("p.kind", {}, first ? (others.length ? "First claim, chosen beforehand" : "Claim") : "What holds right now"),
    el("p.claim#claim", {}, short(first ? first.sentence : story.now, LONGEST_SENTENCE)),
    first ? el("p.muted", {}, claimBasis(first)) : null,
    others.length ? otherClaims(others) : null,
  );
}

function claimBasis(claim) {
  const rule = claim.rule === "single" ? "" : `, ${words(claim.rule)} rule`;
  return `Method ${words(claim.method)}${rule}. It rests on ${plural(claim.assumptions.length, "assumption")}.`;
}

/** What the first claim rests on and the data refute; without a claim, everything that is refuted. */
function refutedOf(story) {
  const broken = story.assumptions.filter((each) => each.status === "refuted");
  const first = story.claims[0];
  return first ? broken.filter((each) => first.refuted.includes(each.id) || first.assumptions.includes(each.id)) : broken;
}

function refutation(story) {
  const broken = refutedOf(story);
  const missing = (story.claims[0]?.refuted ?? []).filter((id) => !broken.some((each) => each.id === id));
  const stopped = story.problems.filter((each) => each.stopped_by === "refuted");
  const number = broken.length + missing.length;
  if (number + stopped.length === 0) return null;
  const [what, rest] = story.claims.length ? ["claim", "rests"] : ["bounds", "rest"];
  const those = number === 1 ? "an assumption that is" : "assumptions that are";
  return el(
    "div.refuted#refuted",
    { role: "alert" },
    el("p.shout", {}, `REFUTED${number ? `: ${plural(number, "assumption")}` : ""}. Do not rely on the ${what} below.`),
    number ? el("p", {}, `The ${what} ${rest} on ${those} refuted ${MEANING.refuted}.`) : null,
    el("dl", {}, broken.map(assumptionItem), missing.map((id) => el("div", {}, el("dt", {}, named(id))))),
    stopped.map((each) => el("p", {}, `The data of ${words(each.name)} contradict its assumptions: its bound is worth nothing.`)),
  );
}

function assumptionItem(each) {
  return el("div", {}, el("dt", {}, named(each.id)), el("dd", {}, short(each.detail, LONGEST_SENTENCE)));
}

function otherClaims(claims) {
  const broken = (claim) => (claim.refuted.length ? el("strong.bad", {}, `${claim.refuted.length} REFUTED`) : "none");
  const rows = claims.map((claim) => [
    short(claim.sentence, LONGEST_SENTENCE), words(claim.method), words(claim.rule), plural(claim.assumptions.length, "assumption"), broken(claim),
  ]);
  return el(
    "details.more",
    { open: true },
    el("summary", {}, plural(claims.length, "further claim")),
    table(["Claim", "Method", "Rule", "Rests on", "Refuted"], rows),
    el("p.muted", {}, "Each claim holds with its own probability; to choose the best of them afterwards costs the sum of what their probabilities lack to 1."),
  );
}

/** The assumptions of the first claim by status; those of other claims alone come last. */
function assumptionSection(story) {
  const first = story.claims[0];
  const ours = story.assumptions.filter((each) => !first || first.assumptions.includes(each.id));
  const others = story.assumptions.filter((each) => !ours.includes(each));
  const groups = GROUPS.map((status) => [status, ours.filter((each) => each.status === status)]).filter(([, list]) => list.length);
  return el(
    "section#assumptions",
    { hidden: story.assumptions.length === 0 },
    el("h2", {}, first ? "What the claim rests on" : "What the bounds rest on"),
    groups.map(([status, list]) => assumptionGroup(status, MEANING[status], list)),
    others.length ? assumptionGroup("more", "on which other claims alone rest", others) : null,
  );
}

/** A group that folds; what is refuted is open. */
function assumptionGroup(status, meaning, list) {
  const item = (each) => (status === "more" ? { ...each, detail: `${each.status}: ${each.detail}` } : each);
  return el(
    "details.group",
    { open: status === "refuted", "data-status": status },
    el("summary", {}, el("span.status", {}, `${list.length} ${status}`), el("span.muted", {}, ` ${meaning}`)),
    el("dl", {}, list.map((each) => assumptionItem(item(each)))),
  );
}

/** From the nominal bound down to ell, term by term. */
function compositionSection(story) {
  const found = story.composition;
  if (!found) return el("section#composition", { hidden: true });
  const { nominal_bound: top, gap_term: gap, risk_term: risk, bound } = found;
  const unit = story.problems[0]?.unit ?? "";
  const rows = [
    ["Nominal bound \u03c1\u0303", 0, top, "whole", outward(top, ">=")],
    ["minus gap term", top - gap, top, "less", `\u2212${outward(gap, "<=")}`],
    ["minus risk term", top - gap - risk, top - gap, "less", `\u2212${outward(risk, "<=")}`],
    ["Bound \u2113", 0, bound, "whole", outward(bound, ">=")],
  ];
  const range = extent(rows.flatMap(([, from, to]) => [from, to]), story.clip ?? [], [0]);
  const marks = [[0, "0", "zero"], ...(story.clip ?? []).map((value) => [value, `clip ${num(value)}`, "clip"])];
  return el(
    "section#composition",
    {},
    el("h2", {}, "How the claim comes about"),
    el("div.bars.waterfall", {}, rows.map(([label, from, to, kind, text]) => barRow(el("span", {}, label), [[from, to, kind]], text, range, marks))),
    barScale(range, marks),
    el("p.muted", {}, `All numbers${unitText(unit) ? ` in ${unitText(unit)}` : ""}, rounded so that they promise no more; combined with the ${words(found.rule)} rule.`),
  );
}

/** A row: what, a bar with marks, a number. */
function barRow(label, bars, text, range, marks) {
  return [el("span.what", {}, label), barPicture(bars, range, marks), el("span.value", {}, text)];
}

/** Bars [from, to, kind] and marks [at, label, kind] over a range. */
function barPicture(bars, range, marks) {
  const at = (value) => 4 + (992 * (value - range[0])) / (range[1] - range[0] || 1);
  const bar = ([from, to, kind]) =>
    svg("rect", { class: kind, x: at(Math.min(from, to)), width: Math.max(2, Math.abs(at(to) - at(from))), y: kind === "mean" ? 3 : 5, height: kind === "mean" ? 14 : 10 });
  const mark = ([value, , kind]) => svg("line", { class: kind, x1: at(value), x2: at(value), y1: 0, y2: 20 });
  return svg("svg", { viewBox: "0 0 1000 20", preserveAspectRatio: "none", "aria-hidden": "true" }, ...bars.map(bar), ...marks.map(mark));
}

/** The names of the marks, under the bars; the list says them in order. */
function barScale(range, marks) {
  const names = [...marks].sort((a, b) => a[0] - b[0]).map(([, label, kind]) => el("li", {}, el(`span.key.${kind}`), label));
  return el("ul.legend", {}, el("li", {}, `scale ${num(range[0])} to ${num(range[1])}`), names);
}

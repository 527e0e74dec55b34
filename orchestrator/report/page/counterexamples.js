// Section of the counterexamples: rollouts that violate the specification, by groups of near starts.

const FIRST_ROWS = 10; // rollouts of a start that are listed at once
const FIRST_STARTS = 10; // starts of a group, and groups
const PAPER_STARTS = 25; // starts that paper lists

/** Rollouts that violate the specification, or the statement that there are none. */
function counterexampleSection(report) {
  const { violations, later_violations: later } = report;
  const head = el("h2", "Counterexamples");
  if (violations === 0) {
    const none = `None among ${plural(allRollouts(report), "recorded rollout")}: no robustness is below 0.`;
    const text = report.specification === null ? "Not applicable: the campaign has no specification." : none;
    return el("section#counterexamples", { "data-violations": 0 }, head, el("p", text));
  }
  // A recheck repeats rollouts that have been counted.
  const checked = allRollouts(report) - (report.closing_rollouts.recheck ?? 0);
  const after = later ? `: ${count(violations - later)} of the ${count(report.rollouts)} for the bounds, and ${count(later)} after the campaign` : "";
  return el(
    "section#counterexamples",
    { "data-violations": violations },
    head,
    el("p", el("strong.bad", plural(violations, "rollout")), ` of ${count(checked)} violated the specification (robustness below 0)${after}. Complete list: `, el("a", { href: "counterexamples.csv" }, "counterexamples.csv"), "."),
    report.violating ? violatingGroups(report, report.violating) : rolloutList(report, report.counterexamples),
  );
}

function violatingGroups(report, violating) {
  const { groups, near } = violating;
  const rollouts = rolloutsByStart(report.counterexamples);
  const unit = robustnessUnit(report);
  const rule = report.axes.length && violating.starts > 1 ? ` Starts are in one group if they, or starts between them, differ by at most ${num(100 * near)} % of its range in every parameter.` : "";
  const element = (group, k) => groupElement(report, group, k, { rollouts, unit });
  const rest = groups.slice(FIRST_STARTS);
  const [all, others] = [plural(violating.starts, "start"), violating.other_starts];
  const starts = others ? `The worst ${count(violating.starts - others)} of ${all},` : all;
  const listed = report.counterexamples.length < report.violations ? ` The list of rollouts has the worst ${count(report.counterexamples.length)}; the numbers count all of them.` : "";
  return [
    el("p.muted", `${starts} in ${plural(groups.length, "group")}, the worst first.${rule}${listed}`),
    groups.slice(0, FIRST_STARTS).map(element),
    rest.length ? el("details.more", { "data-paper": "folded" }, el("summary", `${plural(rest.length, "further group")}`), rest.map((group, k) => element(group, FIRST_STARTS + k))) : null,
    violating.other_starts ? el("p", `and ${plural(violating.other_starts, "further start")}, less bad: ${count(violating.other_violations)} of ${plural(violating.other_rollouts, "rollout")}.`) : null,
  ];
}

/** One group: folded, but the first one; a start of its own is its own list. */
function groupElement(report, group, k, { rollouts, unit }) {
  const single = group.starts.length === 1;
  const title = single ? startText(report, group.low) : rangeText(report, group);
  const starts = single ? "" : `${plural(group.starts.length, "start")}, `;
  const open = k === 0;
  return el(
    "details.violating",
    { open, "data-paper": open ? null : "folded", "data-starts": group.starts.length },
    el("summary", el("span.range", title), ": ", `${starts}${count(group.violations)} of ${plural(group.rollouts, "rollout")}, worst `, el("strong.bad", quantity(group.worst, unit))),
    single ? startRollouts(report, group.starts[0], { rollouts, unit }) : groupStarts(report, group, { rollouts, unit, open }),
  );
}

function groupStarts(report, { starts }, { rollouts, unit, open }) {
  const entry = (start, k) =>
    el(
      "details.start",
      { open: open && k === 0, "data-paper": "folded", class: k >= PAPER_STARTS ? "start screen" : "start" },
      el("summary", el("span.range", startText(report, start.x)), ": ", `${count(start.violations)} of ${count(start.rollouts)}, worst `, el("strong.bad", quantity(start.worst, unit))),
      startRollouts(report, start, { rollouts, unit }),
    );
  const elements = starts.map(entry);
  const left = starts.length - PAPER_STARTS;
  // On paper the last one and the number of those that follow stay together.
  if (left > 0) elements[PAPER_STARTS - 1] = el("div.together", elements[PAPER_STARTS - 1], el("p.on-paper", `and ${plural(left, "start")} more, in counterexamples.csv`));
  const rest = elements.slice(FIRST_STARTS);
  return el("div.starts", elements.slice(0, FIRST_STARTS), rest.length ? el("details.more", el("summary", plural(rest.length, "further start")), rest) : null);
}

/** The listed rollouts of a start, each with the command that repeats it. */
function startRollouts(report, start, { rollouts, unit }) {
  const listed = rollouts.get(start.x.join()) ?? [];
  const missing = start.violations - listed.length;
  return [
    el("p", el("button", { "data-select": `${start.problem}:${start.test}` }, `Show test ${count(start.test)} of ${words(start.problem)}`)),
    listed.length ? rolloutList(report, listed, { unit, at: true }) : null,
    missing > 0 ? el("p.muted", `${listed.length ? `and ${count(missing)} more` : plural(missing, "rollout")}, in counterexamples.csv`) : null,
  ];
}

/** A table of rollouts; `at` tells that their start is named above it. */
function rolloutList(report, rollouts, { unit = robustnessUnit(report), at = false } = {}) {
  const name = (each) => `${words(each.problem)}, test ${count(each.test)}`;
  const test = (each) => el("button", { "data-select": `${each.problem}:${each.test}` }, name(each));
  const cells = (each) => (at ? [name(each), words(each.variant)] : [test(each), words(each.variant), place(each.x, report.axes)]);
  const list = (some) => rolloutTable(["Test", "Variant", ...(at ? [] : ["Start"])], some, cells, { report, unit, onPaper: PAPER_ROWS, where: "in counterexamples.csv" });
  const rest = rollouts.slice(FIRST_ROWS);
  return [list(rollouts.slice(0, FIRST_ROWS)), rest.length ? el("details.more.screen", { "data-paper": "folded" }, el("summary", `${count(rest.length)} more`), list(rest)) : null, rest.length ? el("p.on-paper", `and ${count(rest.length)} more, in counterexamples.csv`) : null];
}

function rolloutsByStart(rollouts) {
  const found = new Map();
  for (const each of rollouts) {
    const key = each.x.join();
    if (!found.has(key)) found.set(key, []);
    found.get(key).push(each);
  }
  return found;
}

/** The unit of the robustness, as the rollouts of a test have it. */
function robustnessUnit(report) {
  return report.scenes.find((each) => each.margin_unit)?.margin_unit ?? "";
}

/** "gap 5 m, speed 29.75 m/s". */
function startText(report, x) {
  const part = (k) => `${axisName(report, k)}${quantity(x[k], report.axes[k]?.unit)}`;
  return report.axes.length ? [...readAxes(report).map(part), ...longInputs(report.axes)].join(", ") : x.map((_, k) => part(k)).join(", ");
}

/** "gap 55 to 60 m, speed 24 to 26 m/s". */
function rangeText(report, { low, high }) {
  const part = (value, k) => `${axisName(report, k)}${value === high[k] ? "" : `${num(value)} to `}${quantity(high[k], report.axes[k]?.unit)}`;
  if (!report.axes.length) return low.map(part).join(", ");
  return [...readAxes(report).map((k) => part(low[k], k)), ...longInputs(report.axes)].join(", ");
}

function axisName(report, k) {
  return report.axes[k] ? `${shortMiddle(report.axes[k].name, 24)} ` : "";
}

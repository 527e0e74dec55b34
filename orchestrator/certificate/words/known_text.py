"""What is known of a campaign, in words: for the terminal, `status`, `show`, the live page and the report."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ....schemas.amounts import counted
from ....schemas.errors import one_line
from ....schemas.result.certificate import Assumption
from ....schemas.result.known import CampaignVerdict, Expected, SoFar, Span, VerdictWord, Violations
from .bound_text import as_required, in_unit, outward
from .format import duration
from .refutation_text import margin_words

COLOURS: dict[VerdictWord, str] = {"SHOWN": "green", "VIOLATED": "red", "NOT SHOWN": "yellow"}
HEAD = ("", "bound", "probability", "tests", "verdict")


NO_LINK = "no time is estimated without the link to the router"


class HoldingRow(NamedTuple):
    """A row of the table of what holds; its cells have the names of `HEAD`."""

    name: str
    bound: str
    probability: str
    tests: str
    verdict: str


def holding_rows(found: SoFar, *, running: bool = True) -> tuple[HoldingRow, HoldingRow]:
    """Return the row of what is proven so far, and that of what is expected at the end, in the time that it runs."""
    ahead = found.expected
    chance = "-" if found.probability is None else f"at least {outward(found.probability, '>=')}"
    bound = None if found.bound is None else in_unit(outward(found.bound, found.sense), found.bound_unit)
    proven = "nothing yet" if bound is None else f"{found.sense} {bound}{', refuted' if found.refuted else ''}"
    count = "-" if ahead.tests is None else _span_words(ahead.tests)
    down = running and found.link_down_since is not None
    left = NO_LINK if down else left_words(ahead, running=running)
    end = f"{ahead.verdict or 'open'}, {left}"
    return (
        HoldingRow("proven so far", proven, chance, f"{found.tests:,}", f"if it ended now: {found.verdict}"),
        HoldingRow("expected at the end", _expected_bound(found), "-" if ahead.bound is None else chance, count, end),
    )


def left_words(ahead: Expected, *, running: bool = True) -> str:
    """Return when a run is expected to end, or how much work a stopped one still has."""
    if ahead.seconds is None:
        return "its time is not known yet"
    low, middle, high = (duration(each) for each in (ahead.seconds.low, ahead.seconds.middle, ahead.seconds.high))
    when = "in" if running else "after a resume,"
    if ahead.by_budget:
        return f"{when} {high} at most, when the budget ends"
    return f"{when} about {middle}" + ("" if low == high else f" ({low} to {high})")


def bar_words(ahead: Expected) -> str:
    """Return the label of the progress bar."""
    of = f"of the budget of {ahead.most_tests:,} tests" if ahead.by_budget else "of the work, by forecast"
    return f"{math.floor(100 * ahead.share)} % {of}"


def assumption_words(found: SoFar) -> str:
    """Return how many assumptions were tested so far, and which of them are refuted; empty before the first test."""
    if not found.assumptions:
        return ""
    refuted = [each.id for each in found.assumptions if each.status == "refuted"]
    of_first = ", ".join(each for each in refuted if each not in found.others)
    further = ", ".join(each for each in refuted if each in found.others)
    parts = [f"REFUTED: {of_first}"] if of_first else []
    parts += [f"refuted, of further claims alone: {further}"] if further else []
    return f"assumptions tested: {'; '.join([*parts, f'{len(found.assumptions) - len(refuted)} not refuted so far'])}"


def consequence_of_key(on_refuted: str) -> str:
    """Return what a refutation leads to, by the key of the campaign file."""
    if on_refuted == "stop":
        return 'A problem ends with the first refutation by its tests (on_refuted = "stop").'
    return (
        'The campaign continues after a refutation by its tests (on_refuted = "continue"); a problem whose own bounds '
        "contradict its constants ends."
    )


def refutation_line(found: Assumption, then: str) -> str:
    """Return the line that reports a refutation the moment it is found."""
    return one_line(f"REFUTED: {found.id}: {found.detail.rstrip('.')}; {then}")


def violations_so_far(found: SoFar) -> str:
    """Return how many rollouts violate the specification so far; empty where none has a robustness."""
    seen = found.violations
    if not seen.rollouts or seen.least is None:
        return ""
    return f"{violations_in_words(seen)} so far; the worst {margin_words(seen.least, found.unit)}."


def so_far_line(found: SoFar) -> str:
    """Return both rows in one line."""
    (now, end), tests = holding_rows(found), counted(found.tests, "test")
    return (
        f"if it ended now: {found.verdict} ({now.bound}, {tests}); expected at the end: {end.bound}, "
        f"{end.verdict}; {bar_words(found.expected)}"
    )


def _expected_bound(found: SoFar) -> str:
    span = found.expected.bound
    if span is None:
        return "no forecast yet" if found.expected.by_budget else "no forecast"
    if span.low == span.high:  # its problem has ended
        end = in_unit(outward(span.low, found.sense), found.bound_unit)
        return f"{found.sense} {end}{', refuted' if found.refuted else ''}"
    low, high = f"{span.low:.4g}", f"{span.high:.4g}"
    return f"about {span.middle:.4g} ({low} to {in_unit(high, found.bound_unit)})"


def _span_words(span: Span) -> str:
    low, high = math.floor(span.low), math.ceil(span.high)
    return f"{low:,}" if low == high else f"about {round(span.middle):,} ({low:,} to {high:,})"


# The verdict on a finished campaign


def verdict_words(found: CampaignVerdict) -> str:
    """Return the verdict, and the constants without whose exact size it would be another one."""
    return f"{found.verdict}, rests on {found.rests_on}" if found.rests_on else found.verdict


def verdict_lines(found: CampaignVerdict, *, vacuous: bool = False) -> Iterator[str]:
    """Yield the verdict, its reasons, what would help, and how many rollouts violate the specification.

    Beside a violation a bound that is `vacuous` is not worth a line.
    """
    yield f"VERDICT  {verdict_words(found)}"
    if found.without_kernel:
        yield found.without_kernel
    # The number of a claim that does not answer the question comes after the answer.
    # Under VIOLATED a bound reads like a pass, and is not the verdict.
    besides = "The bound that was computed too: " if found.verdict == "VIOLATED" else ""
    claim = f"{besides}{_uncapitalised(found.claim) if besides else found.claim}."
    claims = () if vacuous and besides else (claim,)
    yield from (*claims, *found.reasons) if found.verdict == "SHOWN" else (*found.reasons, *claims)
    for sentence in found.advice:
        yield f"What would help: {_uncapitalised(sentence)}"
    if count := violation_words(found):
        yield count


def _uncapitalised(sentence: str) -> str:
    """Return a sentence as the end of another one; an abbreviation keeps its capitals."""
    return sentence if sentence[1:2].isupper() else f"{sentence[0].lower()}{sentence[1:]}"


def first_bound(found: CampaignVerdict) -> str:
    """Return the bound of the first claim with its sense and unit, rounded to the safe side."""
    bound = f"{found.sense} {outward(found.bound, found.sense)} {found.bound_unit}".rstrip()
    return bound if found.clip is None else f"{bound}, clipped"


def required_bound(found: CampaignVerdict) -> str:
    """Return what the file requires of it; empty where that is nothing."""
    return "" if found.required is None else f"{found.sense} {as_required(found.required)} {found.bound_unit}".rstrip()


def violations_in_words(seen: Violations) -> str:
    """Return how many rollouts violate the specification.

    >>> violations_in_words(Violations(rollouts=320, violations=1, starts=9, violating_starts=1, least=-1, rollout="a"))
    '1 of 320 rollouts violates the specification'
    """
    noun = "rollout" if seen.rollouts == 1 else "rollouts"
    verb = "violates" if 1 in {seen.violations, seen.rollouts} else "violate"
    return f"{seen.violations:,} of {seen.rollouts:,} {noun} {verb} the specification"


def violation_words(found: CampaignVerdict) -> str:
    """Return how many rollouts violate the specification; empty where none has a robustness."""
    seen = found.violations
    if not seen.rollouts or seen.least is None:
        return ""
    margin = margin_words(seen.least, found.unit)
    worst = f"the worst {margin}, or lower: the clip" if found.clipped else f"the worst {margin}"
    count = violations_in_words(seen)
    if not seen.violations:
        return f"{count}; {worst}."
    return f"{count}, at {seen.violating_starts:,} of {seen.starts:,} starts, {worst}."


# As a table of two rows, a progress bar, and the tested assumptions

BAR = 40
"""Columns of the progress bar."""


def so_far_view(found: SoFar, *, running: bool = True) -> Group:
    """Return everything that holds now, as lines for a console."""
    return Group(*_lines_of(found, running=running))


def _lines_of(found: SoFar, *, running: bool) -> Iterator[RenderableType]:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in HEAD:
        table.add_column(name, overflow="fold")
    colours = (COLOURS[found.verdict], COLOURS[found.expected.verdict] if found.expected.verdict else "")
    for row, colour in zip(holding_rows(found, running=running), colours, strict=True):
        table.add_row(*(Text(cell) for cell in row[:-1]), Text(row.verdict, colour))
    yield table
    bar = Table.grid(padding=(0, 1))
    bar.add_row(ProgressBar(total=1.0, completed=found.expected.share, width=BAR), Text(bar_words(found.expected)))
    yield bar
    if words := violations_so_far(found):
        yield Text(words, "red" if found.violations.violations else "")
    if words := assumption_words(found):
        yield Text(words, "bold red" if "REFUTED" in words else "")

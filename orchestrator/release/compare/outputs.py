"""A comparison for a terminal."""

from collections.abc import Mapping

from rich.console import Console
from rich.text import Text

from ....schemas.amounts import counted
from ....schemas.errors import one_line
from ....schemas.result.comparison import ComparedQuantity, Comparison, ComparisonVerdict, Difference
from ...certificate.words.bound_text import as_required, clip_words, in_unit, outward
from ...certificate.words.console_lines import aligned, hanging, heading, plain_line

HEAD = ("", "A", "B", "B - A", "verdict")
NUMBERS = (1, 2, 3)
"""The columns of numbers."""
NAMES: Mapping[ComparedQuantity, str] = {
    "mean": "mean robustness",
    "failure_probability": "failure probability",
    "worst_start": "mean robustness at the worst listed start",
    "worst_case": "robustness at the worst start of all",
}
STYLES: Mapping[ComparisonVerdict, str] = {
    "WORSE": "bold red",
    "UNDECIDED": "bold yellow",
    "BETTER": "bold green",
    "EQUAL": "green",
}
CONCLUSIONS: Mapping[ComparisonVerdict, str] = {
    "WORSE": "B IS WORSE",
    "UNDECIDED": "UNDECIDED",
    "BETTER": "B IS BETTER",
    "EQUAL": "EQUAL",
}


def print_comparison(found: Comparison, console: Console) -> None:
    """Print both systems, a line for each difference with its verdict, and the result last."""
    for text in system_lines(found):
        plain_line(console, text)
    console.print()
    head, *lines = aligned([HEAD, *map(row, found.differences)], right=NUMBERS)
    plain_line(console, head, "bold")
    for each, text in zip(found.differences, lines, strict=True):
        line = Text(text)
        line.stylize(STYLES[each.verdict], len(line) - len(verdict_words(each)))
        console.print(line, soft_wrap=True)
    console.print()
    hanging(console, Text(), " ".join(sentences(found)))
    heading(console, conclusion(found), STYLES[found.verdict])


def system_lines(found: Comparison) -> list[str]:
    """Return what is compared, and what the rollouts of a pair share."""
    lines = []
    for name, each in (("A", found.a), ("B", found.b)):
        options = [f"{option} = {value}" for option, value in each.options.items()]
        lines.append(f"{name}  {one_line(', '.join(filter(None, (each.campaign, *options, each.revision))))}")
    if (found.a.system_sha256, found.a.options) == (found.b.system_sha256, found.b.options):
        lines.append("   Both are one system, with the same sources.")
    if not found.common:
        return lines
    *others, last = found.common
    shared = f"{', '.join(others)} and {last}" if others else last
    return [*lines, f"   {counted(found.pairs, 'pair')} of rollouts with the same {shared}"]


def row(found: Difference) -> tuple[str, str, str, str, str]:
    """Return quantity, estimates, interval and verdict of a difference."""
    unit = f", {one_line(found.unit)}" if found.unit not in ("", "1") else ""
    interval = f"{outward(found.lower, '>=')} to {outward(found.upper, '<=')}"
    return f"{NAMES[found.quantity]}{unit}", f"{found.a:.4f}", f"{found.b:.4f}", interval, verdict_words(found)


def verdict_words(found: Difference) -> str:
    """Return the verdict on one difference, with what does not matter where it is one of equality."""
    if found.verdict != "EQUAL" or found.equal_within is None:
        return found.verdict
    return f"EQUAL within {in_unit(as_required(found.equal_within), found.unit)}"


def sentences(found: Comparison) -> list[str]:
    """Return what the intervals mean, and what they rest on."""
    chance = f"With probability at least {outward(found.probability, '>=')}"
    if not found.common:
        words = "the interval contains the difference of the worst cases, if the assumptions of both certificates hold"
        clipped = "" if found.clip is None else f" The robustness is {clip_words(found.clip)}."
        return [f"{chance} {words}; A and B are the middles of their bounds.{clipped}"]
    lines = [f"{chance} all intervals contain their differences, after every pair at once; A and B are estimates."]
    if found.clip is not None:
        lines.append(f"Means are those of the robustness {clip_words(found.clip)}.")
    else:
        lines.append("Without a clip no mean has a bound.")
    return lines


def conclusion(found: Comparison) -> str:
    """Return the result in a line."""
    where = [NAMES[each.quantity] for each in found.differences if each.verdict == found.verdict]
    return f"{CONCLUSIONS[found.verdict]}: {' and '.join(where)}"

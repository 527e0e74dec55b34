"""Fault runs, counted by class."""

from collections.abc import Iterable
from typing import TypedDict

from tests.faults.catalogue import FAULTS
from tests.faults.runs import Run


class Row(TypedDict):
    """Outcome of all runs of one class."""

    fault: str
    runs: int
    injected: int
    twice: int
    lost: int
    different: int
    leftovers: int
    early: int
    failures: int


HEAD = (
    "class",
    "runs",
    "faults injected",
    "recorded twice",
    "lost",
    "different certificates",
    "leftovers",
    "early ends",
    "failures",
)


def rows(runs: Iterable[Run]) -> list[Row]:
    """Return one row a class, and their sum."""
    done = list(runs)
    found = [_row(name, [run for run in done if run.fault == name]) for name in FAULTS]
    return [row for row in [*found, _row("all", done)] if row["runs"]]


def _row(name: str, runs: list[Run]) -> Row:
    verdicts = [run.verdict for run in runs]
    return {
        "fault": name,
        "runs": len(runs),
        "injected": sum(run.injected for run in runs),
        "twice": sum(len(each.twice) for each in verdicts),
        "lost": sum(len(each.lost) for each in verdicts),
        "different": sum(bool(each.different) for each in verdicts),
        "leftovers": sum(len(each.leftovers) for each in verdicts),
        "early": sum(bool(each.early) for each in verdicts),
        "failures": sum(len(each.failures) for each in verdicts),
    }


def text(table: Iterable[Row]) -> str:
    """Return the rows as a table of Markdown."""
    lines = [HEAD, ("---",) * len(HEAD), *(tuple(map(str, row.values())) for row in table)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)

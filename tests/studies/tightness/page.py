"""The generated part of docs/paper.md: the figure, the table of the bounds, and the record of its numbers."""

import json
import statistics
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perfbound.orchestrator.report import style
from perfbound.orchestrator.report.paper.table_text import markdown
from perfbound.schemas import atomic
from tests.studies.pages import page_text, with_part
from tests.studies.tightness.claims import other_claims
from tests.studies.tightness.curves import Curve, Worst
from tests.studies.tightness.figure import figure

FIGURE = "images/paper-rollouts.png"
BEGIN, END = "<!-- bounds against rollouts: begin -->", "<!-- bounds against rollouts: end -->"


RECORD = Path(__file__).with_name("bounds.json")
"""The numbers of the table and of the budgets that it leaves out: median, least and greatest of each bound."""
SHOWN = (128, 400, 1600, 6400)
"""Numbers of rollouts in the table; the figure has all."""


def summary(curves: Sequence[Curve], truth: Worst, recorded: int) -> dict[str, Any]:
    """Return the numbers of the record."""
    return {
        "campaigns": len(next(iter(curves[0].bounds.values()))),
        "recorded": recorded,
        "start": list(truth.x),
        **{name: round(getattr(truth, name), 3) for name in ("risk", "observed", "error")},
        "points": truth.points,
        "curves": [
            {
                "norm": each.norm,
                "controlled": each.controlled,
                "alone": round(each.alone, 3),
                "bounds": {str(count): _spread(values) for count, values in sorted(each.bounds.items())},
                "refuted": each.refuted,
            }
            for each in curves
        ],
    }


def table(numbers: Mapping[str, Any]) -> str:
    """Return the bounds over the seeds, and what the record says of its worst point, from the numbers of a record."""
    head = ["B", "control", "without rollouts", *(f"{count:,}" for count in SHOWN), "refuted"]
    lines = [
        [
            f"{each['norm']:g}",
            "on" if each["controlled"] else "off",
            f"{each['alone']:.3f}",
            *("{:.3f} ({:.3f} to {:.3f})".format(*each["bounds"][str(count)]) for count in SHOWN),
            f"{each['refuted']}",
        ]
        for each in numbers["curves"]
    ]
    start = ", ".join(f"{value:g}" for value in numbers["start"])
    words = (
        f"Bounds of {numbers['campaigns']} campaigns each (median, least and greatest), drawn with replacement from "
        f"{numbers['recorded']:,} recorded rollouts of the true Segway. In this record the risk at the worst of the "
        f"{numbers['points']} points, ({start}), is {numbers['risk']:.3f}, and the least mean of X, to which the "
        f"bounds tend, {numbers['observed']:.3f} +- {numbers['error']:.3f}."
    )
    return f"{markdown(head, lines)}\n{textwrap.fill(words, 100)}\n"


def section(numbers: Mapping[str, Any]) -> str:
    """Return the generated part of the page, with its marks."""
    return f"{BEGIN}\n\n{table(numbers)}\n{END}"


def write(page: Path, curves: Sequence[Curve], truth: Worst, recorded: int, record: Path = RECORD) -> None:
    """Put the figure beside the page, the table between its marks, and all numbers into the record.

    Raises:
        PageError: the page cannot be read, or lacks the marks or a claim.

    """
    text = page_text(page, (BEGIN, END))
    drawn = style.png(figure(curves, truth, other_claims(text)))
    numbers = summary(curves, truth, recorded)
    atomic.write_whole(record, record_text(numbers).encode())
    atomic.write_whole(page, with_part(text, BEGIN, END, section(numbers)).encode())
    atomic.write_whole(page.parent / FIGURE, drawn)


def record_text(numbers: Mapping[str, Any]) -> str:
    """Return a record, one line for each norm."""
    first = {name: value for name, value in numbers.items() if name != "curves"}
    curves = ",\n".join(f"  {json.dumps(each)}" for each in numbers["curves"])
    return f'{json.dumps(first)[:-1]}, "curves": [\n{curves}\n]}}\n'


def _spread(values: Sequence[float]) -> list[float]:
    """Return the median, least and greatest.

    >>> _spread([0.25, 0.5, 0.125])
    [0.25, 0.125, 0.5]
    """
    return [round(each, 3) for each in (statistics.median(values), min(values), max(values))]

"""The generated part of docs/paper.md: the figure and the table of the bounds."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from perfbound.orchestrator.report import style
from perfbound.orchestrator.report.paper.table_text import markdown
from perfbound.schemas import atomic
from tests.tightness.claims import PageError, other_claims
from tests.tightness.curves import Curve, Worst
from tests.tightness.figure import figure

FIGURE = "images/paper-rollouts.png"
BEGIN, END = "<!-- bounds against rollouts: begin -->", "<!-- bounds against rollouts: end -->"


def table(curves: Sequence[Curve], truth: Worst, recorded: int) -> str:
    """Return the bounds over the seeds (median, least, greatest), and what the record says of its worst point."""
    head = ["B", "without rollouts", *(f"{count:,}" for count in sorted(curves[0].bounds)), "refuted"]
    lines = [
        [
            f"{each.norm:g}",
            _short(each.alone),
            *(_spread(each.bounds[n]) for n in sorted(each.bounds)),
            f"{each.refuted}",
        ]
        for each in curves
    ]
    campaigns = len(next(iter(curves[0].bounds.values())))
    start = ", ".join(f"{value:g}" for value in truth.x)
    return (
        f"{markdown(head, lines)}\n"
        f"Bounds of {campaigns} campaigns each, drawn with replacement from {recorded:,} recorded rollouts of the true "
        f"Segway. In this record the risk at the worst of the 25 points, ({start}), is {_short(truth.risk)}, and the "
        f"least mean of X, to which the bounds tend, {_short(truth.observed)} +- {_short(truth.error)}.\n"
    )


def write(page: Path, curves: Sequence[Curve], truth: Worst, recorded: int) -> None:
    """Put the figure beside the page and the table between its marks.

    Raises:
        PageError: the page cannot be read, or lacks the marks or a claim.

    """
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise PageError(f"{page}: {error.strerror}; give --write an existing page") from error
    if BEGIN not in text or END not in text:
        raise PageError(f"{page} has no lines '{BEGIN}' and '{END}': put them where the table belongs")
    drawn = style.png(figure(curves, truth, other_claims(text)))
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    whole = f"{before}{BEGIN}\n\n{table(curves, truth, recorded)}\n{END}{after}"
    atomic.write_whole(page, whole.encode())
    atomic.write_whole(page.parent / FIGURE, drawn)


def _spread(values: Sequence[float]) -> str:
    """Return the median, least and greatest.

    >>> _spread([0.25, 0.5, 0.125])
    '.250 (.125 to .500)'
    """
    return f"{_short(statistics.median(values))} ({_short(min(values))} to {_short(max(values))})"


def _short(value: float) -> str:
    """Return a number below 1 with three digits and without its zero.

    >>> _short(0.5019), _short(-0.31)
    ('.502', '-.310')
    """
    return f"{value:.3f}".replace("0.", ".", 1)

"""The bound so far on a terminal: rounded so that it claims no more than is proven."""

import io

import pytest
from rich.console import Console

from perfbound.orchestrator.run.display.progress import Plain
from perfbound.orchestrator.run.display.progress_table import LEGEND, bound_in_sense, bound_text, progress_table
from perfbound.orchestrator.run.service import RunStatus
from perfbound.schemas.values import Bound, ProblemProgress
from tests.campaigns import config

CAMPAIGN = config("segway-paper")
"""Its first problem is bounded from below, its second one from above."""


def progress(upper: float | None) -> ProblemProgress:
    return ProblemProgress(tests=7, rollouts=7, F=0.2, bound=Bound(upper, None, None), stopped_by="budget")


@pytest.mark.parametrize(
    ("place", "upper", "shown"),
    [
        (0, -0.196799, "0.1967"),
        (0, 0.02341, "-0.0235"),
        (0, 0.00011, "-0.00011"),
        (1, 0.468014, "0.4681"),
        (1, 0.5, "0.5000"),
        (1, None, "-"),
    ],
)
def test_it_is_rounded_to_the_safe_side(place: int, upper: float | None, shown: str) -> None:
    problem = CAMPAIGN.problems[place]
    assert bound_text(CAMPAIGN, problem, bound_in_sense(CAMPAIGN, problem, progress(upper))) == shown
    rows = [progress(None), progress(None)]
    rows[place] = progress(upper)
    out = io.StringIO()
    Console(file=out, width=150).print(progress_table(CAMPAIGN, [(each, "") for each in rows]))
    assert f" {shown} " in out.getvalue().splitlines()[1 + place]
    lines = io.StringIO()
    problems: dict[str, ProblemProgress] = {
        problem.name: each for problem, each in zip(CAMPAIGN.problems, rows, strict=True)
    }
    Plain(Console(file=lines, width=150)).show(
        RunStatus(CAMPAIGN, problems, {}, workers={}, known={}, recorded=7, waiting=0, seconds=1.0)
    )
    first, legend, second = lines.getvalue().splitlines()
    assert f"bound so far {shown}; budget ended" in (first, second)[place]
    assert legend == LEGEND, "once, after the first line with an F"

"""Progress of a campaign as a table with one row per problem."""

from collections.abc import Mapping, Sequence

from rich.table import Table

from ....schemas.file.config import CampaignConfig
from ....schemas.file.parts import alpha_of
from ....schemas.file.problem_models import Problem
from ....schemas.ids import IMPORTANCE, RECHECK, RISK_CHECK, SHRINK, SIMPLEST, SPOT_CHECK, closing_check
from ....schemas.values import ProblemProgress
from ...campaign.clip import by_clip, floored
from ...certificate.words.bound_text import outward
from ...certificate.words.format import ENDS, figure
from ...forecast import remaining

LEGEND = (
    "F: width of the confidence band at the start of a test, before its outcome; it may rise from test to test, and a "
    "problem ends when it is at most alpha"
)


def legend_lines(config: CampaignConfig) -> tuple[str, ...]:
    """Return what F means, for a campaign that has one."""
    return (LEGEND,) if any(problem.method == "paper" for problem in config.problems) else ()


def bound_in_sense(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> float | None:
    """Return the bound so far in the unit and sense of the problem: -eps for a minimum; never weaker than the clip."""
    upper = progress.bound.upper if progress.bound else None
    if upper is None:
        return None
    sense = config.sense_of(problem)
    return floored(-upper if sense == "min" else upper, sense, by_clip(config, problem))


def proven_bound(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> float | None:
    """Return the same as far as it holds now: before its end a method that claims nothing until then has none."""
    early = problem.bound_at_end and progress.stopped_by is None
    return None if early else bound_in_sense(config, problem, progress)


def bound_text(config: CampaignConfig, problem: Problem, bound: float | None) -> str:
    """Return a bound, rounded to the safe side; a dash without one."""
    return "-" if bound is None else outward(bound, ">=" if config.sense_of(problem) == "min" else "<=")


def remaining_distance(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> float | None:
    """Return the quantity that has to fall to alpha: F_i, or upper - lower."""
    if alpha_of(config, problem) is None:
        return None
    return remaining.distance(problem, progress.F, progress.bound)


def progress_table(
    config: CampaignConfig,
    rows: Sequence[tuple[ProblemProgress, str]],
    closing: Mapping[str, ProblemProgress] | None = None,
) -> Table:
    """Return one row per problem, in the order of the campaign file: its progress, and the text of column `left`.

    The closing checks that have begun follow.
    """
    found = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("problem", "tests", "F or U-L", "alpha", "bound so far", "rollouts", "left"):
        # Where the terminal is narrow a number continues in the next line: one without its end would be another number.
        found.add_column(name, justify="left" if name == "problem" else "right", overflow="fold")
    for problem, (progress, left) in zip(config.problems, rows, strict=True):
        alpha = alpha_of(config, problem)
        found.add_row(
            problem.name,
            f"{progress.tests:,} of {remaining.budget(config, problem, progress.extended):,}",
            figure(remaining_distance(config, problem, progress)),
            figure(alpha) if alpha is None else f"{alpha:g}",
            bound_text(config, problem, proven_bound(config, problem, progress)),
            f"{progress.rollouts:,}",
            ENDS[progress.stopped_by] if progress.stopped_by else left,
            style="green" if progress.stopped_by == "converged" else "",
        )
    for name, progress in (closing or {}).items():
        most = {
            SPOT_CHECK: config.spot_check + config.spot_check_followups,
            RISK_CHECK: config.spot_check_followups,
            SHRINK: config.falsify.improving_tests if config.falsify else 0,
            IMPORTANCE: config.falsify.sampled_tests if config.falsify else 0,
            SIMPLEST: config.falsify.most_simplifying_tests if config.falsify else 0,
            RECHECK: config.recheck,
        }[closing_check(name) or name]
        end = "ended" if progress.stopped_by else f"of at most {most:,} tests"
        found.add_row(name, f"{progress.tests:,}", "", "", "", f"{progress.rollouts:,}", end)
    return found

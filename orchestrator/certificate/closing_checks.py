"""Construction of the results of spot check and recheck."""

from ...schemas import certificate as document
from ...schemas.problems import OBJECTIVES, ProblemName
from ..campaign.ledger import Ledger
from ..campaign.spot_check import LEVEL, SpotCheck, SpotSeries
from ..mathematics.bounds.rounding import round_up
from ..mathematics.bounds.share import clopper_pearson_upper, unseen_share
from ..mathematics.bounds.spot_check import SpotFinding

UNSEEN = 0.05
"""Probability that the recheck misses the share of irreproducible rollouts which it names."""
DIGITS = 6
"""Of a wealth, whose last digits depend on the CPU."""


def spot_check(ledger: Ledger) -> document.SpotCheck | None:
    """Return the result of the spot check; None for a campaign without one."""
    check, series = ledger.closing.spot_check, ledger.series.get(SpotCheck.name)
    if check is None or not isinstance(series, SpotSeries):
        return None
    starts = len(check.starts)
    failures = sum(value < 0 for value in series.robustness.values()) if series.robustness else None
    return document.SpotCheck(
        starts=starts,
        rollouts=document.Rollouts(nominal=series.counts["nominal"], true=series.counts["true"]),
        level=LEVEL,
        failures=failures,
        failure_probability=None if failures is None else clopper_pearson_upper(failures, starts, LEVEL),
        problems=tuple(_problem(check, name, found) for name, found in check.findings().items()),
    )


def _problem(check: SpotCheck, name: ProblemName, found: SpotFinding) -> document.SpotCheckedProblem:
    hypothesis = check.hypotheses[name]
    return document.SpotCheckedProblem(
        name=name,
        status=found.status,
        limit=-hypothesis.limit if OBJECTIVES[name].sense == "min" else hypothesis.limit,
        noisy=hypothesis.noisy,
        rollouts=found.rollouts,
        violations=found.violations,
        violated_share=found.share,
        start=None if found.start is None else check.starts[found.start],
        wealth=None if found.wealth is None else float(f"{found.wealth:.{DIGITS}g}"),
        undecided=found.undecided,
    )


def recheck(ledger: Ledger) -> document.Recheck | None:
    """Return the result of the recheck; None for a campaign without one."""
    if ledger.closing.recheck is None:
        return None
    count = len(ledger.closing.recheck.rollouts)
    return document.Recheck(
        rollouts=count,
        agreed=sum(each == 1.0 for each in ledger.series[ledger.closing.recheck.name].observations),
        unseen_share=min(1.0, round_up(unseen_share(count, UNSEEN))) if count else 1.0,
    )

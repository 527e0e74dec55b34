"""Construction of the results of spot check and recheck."""

from collections.abc import Sequence

from ...schemas.result import certificate as document
from ..campaign.clip import hiding, reach_of
from ..campaign.closing.risk_check import RiskCheck
from ..campaign.closing.spot_check import SpotCheck, SpotSeries, tested_variant
from ..campaign.ledger import Ledger
from ..campaign.objectives import mean
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.checks.spot_check import SpotFinding
from ..mathematics.bounds.one_law.predictable import CvarSequence
from ..mathematics.bounds.one_law.share import clopper_pearson_upper, quantile_lower, unseen_share
from ..mathematics.bounds.rounding import round_up

SHARE = 0.1
"""Of the starts, which the bound without a kernel leaves out."""
UNSEEN = 0.05
"""Probability that the recheck misses the share of irreproducible rollouts which it names."""
DIGITS = 6
"""Of a wealth, whose last digits depend on the CPU."""


def spot_check(ledger: Ledger) -> document.SpotCheck | None:
    """Return the result of the spot check; None for a campaign without one."""
    check = ledger.closing.spot_check
    series = None if check is None else ledger.series.get(check.name)
    if check is None or not isinstance(series, SpotSeries):
        return None
    starts = len(check.starts)
    robustness = [values for _, values in sorted(series.robustness.items()) if values]
    failures = sum(values[0] < 0 for values in robustness) if robustness else None
    return document.SpotCheck(
        starts=starts,
        rollouts=document.Rollouts(nominal=series.counts["nominal"], true=series.counts["true"]),
        level=check.level,
        failures=failures,
        failure_probability=None if failures is None else clopper_pearson_upper(failures, starts, check.level),
        most_starts=_most_starts(ledger, check, robustness) if robustness else None,
        problems=tuple(_problem(check, plan, found, ledger.closing.risk_check) for plan, found in check.findings()),
    )


def _most_starts(
    ledger: Ledger, check: SpotCheck, robustness: Sequence[tuple[float, ...]]
) -> document.MostStarts | None:
    """Return what the rollouts of the first test at each start prove of all starts but `SHARE`."""
    noisy, clip = tested_variant(check.variants) in ledger.header.spec.noisy, ledger.config.clip
    bound = _mean_of_most(robustness, clip, check.level) if noisy else _value_of_most(robustness, check.level)
    # What the clip alone proves is no bound.
    if bound is None or (clip is not None and bound <= clip[0]):
        return None
    within = reach_of(ledger.config.formula, ledger.header.spec.after_end, ledger.config.beyond)
    return document.MostStarts(
        share=SHARE,
        quantity="expected_robustness" if noisy else "robustness",
        bound=bound,
        probability=1 - check.level,
        clipped=hiding(clip, within, "mean" if noisy else "each", ">=", bound=bound),
    )


def _value_of_most(robustness: Sequence[tuple[float, ...]], level: float) -> float | None:
    """Return a quantile bound of values without noise; None for too few starts."""
    return quantile_lower((value for value, *_ in robustness), SHARE, level)


def _mean_of_most(
    robustness: Sequence[tuple[float, ...]], clip: tuple[float, float] | None, level: float
) -> float | None:
    """Return a bound of the means of noisy values; None without a clip, and where no more than the clip is proven."""
    if clip is None:
        return None
    bound = CvarSequence(SHARE, clip, delta=level)
    for values in robustness:
        # A mean of clipped values may leave the clip by round-off.
        bound.add(min(max(mean(values), clip[0]), clip[1]))
    return bound.lower() if bound.lower() > clip[0] else None


def _problem(
    check: SpotCheck, plan: ProblemPlan, found: SpotFinding, risk: RiskCheck | None
) -> document.SpotCheckedProblem:
    hypothesis = check.hypotheses[plan.key]
    return document.SpotCheckedProblem(
        name=plan.name,
        status=found.status,
        limit=-hypothesis.limit if plan.sense == "min" else hypothesis.limit,
        noisy=hypothesis.noisy,
        rollouts=found.rollouts,
        violations=found.violations,
        violated_share=found.share,
        start=None if found.start is None else check.starts[found.start],
        wealth=None if found.wealth is None else float(f"{found.wealth:.{DIGITS}g}"),
        undecided=found.undecided,
        requirement=plan.requirement,
        risk=None if risk is None else _risk_at_start(risk, plan.key),
    )


def _risk_at_start(check: RiskCheck, key: str) -> document.RiskAtStart | None:
    named = check.finding(key)
    if named is None:
        return None
    return document.RiskAtStart(
        status="below" if named.is_below else "not decided",
        rollouts=named.bound.count,
        mean=named.bound.mean,
        deviation=named.bound.deviation,
        risk=named.bound.upper,
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

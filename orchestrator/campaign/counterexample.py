"""The counterexample that ends a campaign: the first test, in test order, with a rollout below robustness 0.

The order is that of the tests, not of the results, so that the number and the speed of the workers change nothing. The
bound up to there holds as it does after every test: methods `rigorous` and `scenario` are valid at every moment, also
at one that depends on the outcomes.
"""

from dataclasses import replace

from ...schemas.file.config import CampaignConfig
from ...schemas.result.facts import RolloutFact
from ...schemas.values import Bound
from .series import Series


def ended(config: CampaignConfig, bound: Bound, series: Series) -> Bound:
    """Return the bound after the last test of a series, whose rollouts end it if the campaign seeks a counterexample.

    A method that refutes its own constants says so instead: the counterexample is in the data all the same.
    """
    if config.until_counterexample and bound.verdict != "refuted" and any(map(_violates, series.last_rollouts)):
        # A verdict of this test, so that resume, replay and `verify` decide it as they decide those of a method.
        return replace(bound, verdict="counterexample")
    return bound


def counterexample(series: Series) -> RolloutFact | None:
    """Return the worst rollout of the test that ended a problem as a counterexample; None if something else did."""
    last = series.last_bound
    if last is None or last.stopped_by != "counterexample":
        return None
    return min(filter(_violates, series.last_rollouts), key=lambda each: (each.robustness, each.rollout))


def _violates(rollout: RolloutFact) -> bool:
    return rollout.robustness is not None and rollout.robustness < 0

"""The counterexample that ends a campaign: the first test, in test order, with a rollout below robustness 0.

The order is that of the tests, not of the results, so that the number and the speed of the workers change nothing. The
bound up to there holds as it does after every test: methods `rigorous` and `scenario` are valid at every moment, also
at one that depends on the outcomes. A search that continues ends with so many clusters of failing starts, or with its
budget.
"""

from dataclasses import dataclass, replace

from ...schemas.file.config import CampaignConfig
from ...schemas.result.facts import RolloutFact
from ...schemas.values import Bound
from .region import Start
from .series import Account, worst_rollout


@dataclass(frozen=True, slots=True)
class Found:
    """A failing test: its start, and its worst rollout."""

    start: Start
    rollout: RolloutFact


def ended(config: CampaignConfig, bound: Bound, account: Account) -> Bound:
    """Return the bound after the last test of a problem, whose failures end it if the campaign seeks them.

    A method that refutes its own constants says so instead: the counterexample is in the data all the same.
    """
    if bound.verdict != "refuted" and _is_found(config, account):
        # A verdict of this test, so that resume, replay and `verify` decide it as they decide those of a method.
        return replace(bound, verdict="counterexample")
    return bound


def _is_found(config: CampaignConfig, account: Account) -> bool:
    if config.until_counterexample:
        return any(map(_violates, account.last_rollouts))
    sought = None if config.falsify is None else config.falsify.clusters
    return sought is not None and account.clusters is not None and len(account.clusters.found) >= sought


def counterexample(account: Account) -> Found | None:
    """Return the failing test that ended a problem, or the worst one of a search that continued; None without one."""
    return min(found_failures(account), key=lambda each: each.rollout.robustness or 0.0, default=None)


def found_failures(account: Account) -> list[Found]:
    """Return the failing test that ended a problem, or the worst one of each cluster of a search that continued."""
    if account.clusters is not None:
        return [Found(each.worst.start, each.worst.test) for each in account.clusters.found]
    last = account.last_bound
    if last is None or last.stopped_by != "counterexample":
        return []
    assert account.last_proposal is not None, "it was tested"
    return [Found(account.last_proposal.x, worst_rollout(account.last_rollouts))]


def _violates(rollout: RolloutFact) -> bool:
    return rollout.robustness is not None and rollout.robustness < 0

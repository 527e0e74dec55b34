"""What a campaign has found that seeks failures: the counterexample, the clusters, and what tests at random show."""

from collections.abc import Sequence

from ...schemas.ids import RolloutId
from ...schemas.result import certificate as document
from ...schemas.result.facts import Header, RolloutFact
from ..campaign.closing.likeliest import LikeliestFailure
from ..campaign.closing.shrink import Shrink
from ..campaign.closing.spot_check import LEVEL
from ..campaign.counterexample import counterexample
from ..campaign.ledger import Ledger
from ..campaign.observation import goal_of_search
from ..campaign.series import Account
from ..mathematics.bounds.one_law.failures import beta_mixture_lower, beta_mixture_upper
from ..mathematics.bounds.one_law.weighted import DEFENSIVE
from ..mathematics.search.clusters import Cluster
from ..mathematics.stl.text import text

OF_SHARE = 0.95
"""Probability that the share of failing tests is between its two bounds."""


def counterexample_of(ledger: Ledger) -> document.Counterexample | None:
    """Return the counterexample of a campaign, with what followed it; None without one."""
    for account in ledger.accounts.values():
        if (found := counterexample(account)) is not None:
            rollout = found.rollout
            return document.Counterexample(
                rollout=str(rollout.rollout),
                test=rollout.rollout.test,
                # A search has single tests, and another campaign ends with the last ones.
                rollouts=len(account.last_rollouts if account.clusters is None else account.plan.rollouts),
                start=dict(zip(account.plan.parameters, found.start, strict=True)),
                seed=rollout.seed,
                disturbances=_values(ledger.header, rollout.rollout, found.start, rollout.seed),
                robustness=rollout.robustness or 0.0,
                shrunk=_shrunk(ledger, account.plan.parameters),
                likeliest=_likeliest(ledger, account.plan.parameters, rollout.seed),
                simplest=None if account.clusters else _simplest(ledger, rollout),
            )
    return None


def failures_of(ledger: Ledger) -> document.Failures | None:
    """Return the clusters of failing starts; None of a campaign that ends with the first one, or has none."""
    for account in ledger.accounts.values():
        if account.clusters is not None and account.clusters.found:
            parts = [text(each) for each in goal_of_search(ledger.config, ledger.header.spec)[1]]
            names = account.plan.parameters
            clusters = tuple(_cluster(ledger, each, names, parts) for each in account.clusters.found)
            return document.Failures(clusters=clusters, undecided=account.clusters.undecided)
    return None


def _cluster(
    ledger: Ledger, cluster: Cluster[RolloutFact], parameters: Sequence[str], parts: Sequence[str]
) -> document.FailureCluster:
    worst = cluster.worst
    return document.FailureCluster(
        violated=tuple(parts[number] for number in cluster.violated),
        tests=len(cluster.failures),
        starts=dict(zip(parameters, zip(*cluster.box, strict=True), strict=True)),
        start=dict(zip(parameters, worst.start, strict=True)),
        robustness=worst.margin,
        rollout=str(worst.test.rollout),
        seed=worst.test.seed,
        simplest=_simplest(ledger, worst.test),
    )


def _simplest(ledger: Ledger, failure: RolloutFact) -> document.Simplest | None:
    """Return the simplest failure that follows from one; None where none was sought."""
    sought = ledger.closing.simplest
    found = None if sought is None else sought.of(failure.rollout)
    if sought is None or found is None:
        return None
    names = [parameter.name for parameter in ledger.header.spec.parameters]
    start, robustness, rollout = found.best
    return document.Simplest(
        nominal=dict(zip(names, sought.nominal, strict=True)),
        start=dict(zip(names, start, strict=True)),
        away=tuple(names[number] for number in found.away),
        robustness=robustness,
        rollout=str(rollout),
        rollouts=found.tests,
    )


def _shrunk(ledger: Ledger, parameters: Sequence[str]) -> document.Shrunk | None:
    shrink = ledger.closing.shrink
    if not isinstance(shrink, Shrink):
        return None
    start, robustness, rollout = shrink.best
    return document.Shrunk(
        nominal=dict(zip(parameters, shrink.nominal, strict=True)),
        start=dict(zip(parameters, start, strict=True)),
        robustness=robustness,
        rollout=str(rollout),
        rollouts=len(ledger.series[shrink.name].observations),
    )


def _likeliest(ledger: Ledger, parameters: Sequence[str], seed: int) -> document.LikeliestFailure | None:
    sought = ledger.closing.shrink
    if not isinstance(sought, LikeliestFailure):
        return None
    start, robustness, rollout = sought.best
    return document.LikeliestFailure(
        start=dict(zip(parameters, start, strict=True)),
        disturbances=_values(ledger.header, rollout, start, seed),
        distance=sought.distance,
        robustness=robustness,
        rollout=str(rollout),
        rollouts=len(ledger.series[sought.name].observations),
        at_start=_at_start(ledger),
    )


def _at_start(ledger: Ledger) -> document.FailureAtStart | None:
    sampled = ledger.closing.importance
    if sampled is None:
        return None
    count = len(ledger.series[sampled.name].observations)
    return document.FailureAtStart(
        bound=sampled.lower(count),
        probability=1 - LEVEL,
        rollouts=count,
        failures=len(sampled.weights),
        share=DEFENSIVE,
    )


def _values(header: Header, rollout: RolloutId, start: Sequence[float], seed: int) -> dict[str, document.DrawnValue]:
    """Return the values of the disturbances of a rollout by their names."""
    drawn = header.template.disturbances(rollout.variant, [start], [seed])
    each = zip(header.spec.disturbances, drawn[0] if drawn else (), strict=bool(drawn))
    return {law.name: document.DrawnValue(value=value, unit=law.unit) for law, value in each}


def search_of(ledger: Ledger) -> document.Search | None:
    """Return what the tests of a search show beside its failures; None of a campaign without one."""
    for account in ledger.accounts.values():
        if account.plan.falsify is not None:
            return document.Search(at_random=_at_random(account), closest=_closest(account))
    return None


def _at_random(account: Account) -> document.RandomTests | None:
    """Return the failures among the drawn tests alone: where no start is drawn, or none was yet, there are none."""
    plan = account.plan
    drawn = [test for test in range(len(account.observations)) if plan.is_drawn(test)]
    if not drawn:
        return None
    # Each start is drawn whatever was observed before it, so that they are independent. Outcomes may decide when the
    # campaign ends: the bounds hold at all numbers of tests at once, which those of Clopper and Pearson do not.
    failures, each = int((account.each.firsts(0)[drawn] < 0.0).sum()), (1.0 - OF_SHARE) / 2
    return document.RandomTests(
        tests=len(drawn),
        failures=failures,
        share=(beta_mixture_lower(failures, len(drawn), each), beta_mixture_upper(failures, len(drawn), each)),
        probability=OF_SHARE,
    )


def _closest(account: Account) -> document.ClosestStart | None:
    """Return the test next to a failure; None where one fails."""
    if account.lowest is None:
        return None
    start, rollout = account.lowest
    if rollout.robustness is None or rollout.robustness < 0.0:
        return None
    return document.ClosestStart(
        start=dict(zip(account.plan.parameters, start, strict=True)),
        robustness=rollout.robustness,
        rollout=str(rollout.rollout),
        seed=rollout.seed,
    )

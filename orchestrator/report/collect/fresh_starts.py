"""The fresh starts of a spot check: what was observed there, and where that is a violation or contradicts the bound."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from ....schemas.ids import SPOT_CHECK, closing_check
from ....schemas.result.block_facts import BlockObservationFact, BlockProposalFact
from ....schemas.result.certificate import Predicate, SpotCheckedProblem
from ....schemas.result.facts import ObservationFact, ProposalFact, RolloutFact
from ...campaign.plan import ProblemPlan
from ..data.charts import FailingStart
from . import limits
from .observed import signed

MOST_FAILING = 100
"""Failing starts in the data, the worst of them."""

Values = tuple[float, ...]


@dataclass(slots=True)
class _Start:
    x: tuple[float, ...]
    test: int
    """The first one there."""
    first: Values = ()
    """J of every tested bound for each replicate, of the first test."""
    every: list[Values] = field(default_factory=list)
    """The same of each test."""
    violations: dict[str, int] = field(default_factory=dict)
    """Rollouts that violate the specification, by variant."""


@dataclass(slots=True)
class FreshStarts:
    """The observed tests at the fresh starts of each spot check, by its name and the number of the start."""

    _starts: dict[str, dict[int, _Start]] = field(default_factory=dict)
    _proposed: dict[tuple[str, int], int] = field(default_factory=dict)

    def add(self, fact: object) -> None:
        """Add a fact of a series; those of problems and other checks are left out."""
        match fact:
            case ProposalFact() if closing_check(fact.problem) == SPOT_CHECK:
                node = self._proposed[fact.problem, fact.test] = fact.proposal.node
                self._starts.setdefault(fact.problem, {}).setdefault(node, _Start(fact.proposal.x, fact.test))
            case ObservationFact() if closing_check(fact.problem) == SPOT_CHECK:
                found = self._starts[fact.problem][self._proposed[fact.problem, fact.test]]
                # Follow-ups go to the most suspicious starts: with them the values would no longer be a fair sample.
                found.first = found.first or fact.observation.each
                found.every.append(fact.observation.each)
            case BlockProposalFact() | BlockObservationFact() if closing_check(fact.problem) == SPOT_CHECK:
                for each in fact.each():
                    self.add(each)

    def add_violation(self, fact: RolloutFact) -> None:
        """Add a rollout that violates the specification, after the proposal of its test; others are left out."""
        rollout = fact.rollout
        node = self._proposed.get(rollout[:2])
        if node is not None:
            counted = self._starts[rollout.problem][node].violations
            counted[rollout.variant] = counted.get(rollout.variant, 0) + 1

    def latest(self) -> tuple[Mapping[int, tuple[float, ...]], Mapping[int, Values]]:
        """Return starts and first values of the last spot check; of several, each follows an extension."""
        _, starts = self._last()
        observed = {node: each for node, each in starts.items() if each.every}
        return {node: each.x for node, each in observed.items()}, {node: each.first for node, each in observed.items()}

    def failing(self, predicate: Predicate, plan: ProblemPlan) -> tuple[FailingStart, ...]:
        """Return where rollouts violate the specification or contradict the bound of a problem, the worst first."""
        tested = predicate.spot_check.problems if predicate.spot_check else ()
        place = next((place for place, each in enumerate(tested) if each.key == plan.key), None)
        if place is None:
            return ()
        name, starts = self._last()
        found = [_failing(name, each, place, tested, plan) for each in starts.values() if each.every]
        worse = 1.0 if plan.sense == "min" else -1.0
        worst_first = sorted((each for each in found if each is not None), key=lambda each: worse * each.value)
        return tuple(worst_first[:MOST_FAILING])

    def _last(self) -> tuple[str, Mapping[int, _Start]]:
        names = [name for name, starts in self._starts.items() if any(each.every for each in starts.values())]
        return (names[-1], self._starts[names[-1]]) if names else ("", {})


def _failing(
    name: str, start: _Start, place: int, tested: tuple[SpotCheckedProblem, ...], plan: ProblemPlan
) -> FailingStart | None:
    """Return a start if it fails: its value is the mean of all rollouts there, with the sign of the objective."""
    finding = tested[place]
    values = [value for each in start.every for value in _of_objective(each[place :: len(tested)], plan.sense)]
    # The values are no robustness where a risk is bounded through an expectation, so its rollouts are counted.
    counted = start.violations if limits.is_robustness(plan) else {}
    violations = sum(number for variant, number in counted.items() if variant in plan.variants)
    mean = math.fsum(values) / len(values)
    beyond = mean < finding.limit if plan.sense == "min" else mean > finding.limit
    # One value with noise contradicts no bound; the check names a start where they do together.
    contradicts = finding.status == "refuted" and (start.x == finding.start or (beyond and not finding.noisy))
    if not violations and not contradicts:
        return None
    return FailingStart(start.x, name, start.test, mean, len(values), violations, contradicts)


def _of_objective(values: Values, sense: str) -> Iterator[float]:
    return (found for value in values if (found := signed(value, sense)) is not None)


def is_refuted(predicate: Predicate, plan: ProblemPlan) -> bool:
    """Whether the bound of a problem, or of a requirement, rests on a refuted assumption."""
    broken = {each.id for each in predicate.assumptions if each.status == "refuted"}
    of_claims = {name for claim in predicate.claims for name in claim.refuted}
    whose = {plan.name, plan.key, ""}  # the last one is that of the whole campaign, if some claim rests on it
    return any(each.partition("/")[2] in whose for each in broken & of_claims)

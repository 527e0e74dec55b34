"""Bounds of method `kriging` against the number of true rollouts, one curve for each assumed norm B.

Every campaign draws its rollouts with replacement from the record of its starts: all of one law, that of the record.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perfbound.orchestrator.campaign.methods import bases, kernel_method
from perfbound.orchestrator.mathematics.bounds.kriging.design import Design
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingMethod
from perfbound.orchestrator.mathematics.bounds.one_law.risk import linearised
from perfbound.orchestrator.mathematics.control.sequence import Disturbed
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.schemas.file.problem_models import KrigingProblem
from perfbound.schemas.values import Bound, Observation
from tests.studies.tightness.rollouts import SEED, Recorded, Subject

NORMS = (0.14, 0.23, 0.36, 0.5, 1.0)
SEEDS = 21


class Budget(NamedTuple):
    """Tests, and rollouts of each."""

    tests: int
    replicates: int

    @property
    def rollouts(self) -> int:
        """Number of rollouts."""
        return self.tests * self.replicates


BUDGETS = (Budget(128, 1), Budget(100, 4), Budget(100, 8), Budget(100, 16), Budget(200, 16), Budget(400, 16))
"""At least 100 tests each, so that every point of the design has its share."""


@dataclass(frozen=True, slots=True)
class Curve:
    """The bounds of the risk that one norm gives, by number of rollouts, in the unit of the robustness."""

    norm: float
    alone: float
    """What norm and prior mean prove without a rollout."""
    bounds: dict[int, list[float]]
    refuted: int
    """Campaigns whose audit refutes the norm."""
    controlled: bool = True


def curve(subject: Subject, recorded: Recorded, norm: float, seeds: int = SEEDS, *, controlled: bool = True) -> Curve:
    """Return the bounds of `seeds` campaigns of every budget; a seed has the same rollouts in every curve."""
    values = {node: observed(subject, each) for node, each in recorded.robustness.items()}
    bounds, refuted, alone = dict[int, list[float]](), 0, 0.0
    for place, budget in enumerate(BUDGETS):
        planned = a_method(subject, norm, budget)
        alone = _claim(planned.bound_after([]))
        found = []
        for seed in range(seeds):
            drawn = drawn_tests(planned.design, recorded, budget, (place, seed))
            method = a_method(subject, norm, budget, known(subject, drawn)) if controlled else deepcopy(planned)
            found.append(campaign(method, values, drawn))
        bounds[budget.rollouts] = [_claim(bound) for bound in found]
        refuted += sum(bound.verdict == "refuted" for bound in found)
    return Curve(norm, alone, bounds, refuted, controlled)


def a_method(subject: Subject, norm: float, budget: Budget, known: Disturbed | None = None) -> KrigingMethod:
    """Return the method of the campaign file with another norm and budget, before its first test."""
    plan = subject.plan
    assert isinstance(plan.problem, KrigingProblem)
    problem = plan.problem.model_copy(update={"rkhs_norm": norm})
    found = kernel_method(replace(plan, problem=problem, budget=budget.tests, replicates=budget.replicates), known)
    assert isinstance(found, KrigingMethod)
    return found


class Drawn(NamedTuple):
    """The rollouts of one test."""

    node: int
    numbers: NDArray[np.intp]
    scores: Floats


def drawn_tests(design: Design, recorded: Recorded, budget: Budget, number: tuple[int, int]) -> list[Drawn]:
    """Return the tests of a campaign, whose rollouts are drawn with replacement from the record."""
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=number))
    found = []
    for node in (design.nodes[point] for point in design.order):
        numbers = rng.choice(len(recorded.robustness[node]), budget.replicates)
        found.append(Drawn(node, numbers, recorded.scores[node][numbers]))
    return found


def known(subject: Subject, tests: Sequence[Drawn]) -> Disturbed:
    """Return the disturbances of the tests of a campaign."""
    return Disturbed(bases(subject.system.spec), lambda test, _: tests[test].scores)


def observed(subject: Subject, robustness: Floats) -> Floats:
    """Return X of each rollout: its mean is not above the risk."""
    constants, weight = subject.plan.problem.observed_through, subject.plan.risk_weight
    assert constants is not None
    return np.array([linearised(value, weight, constants.centre, constants.spread) for value in robustness.tolist()])


def campaign(method: KrigingMethod, values: dict[int, Floats], tests: Sequence[Drawn]) -> Bound:
    """Return the bound after all tests of a campaign; `values` are those of X of the record."""
    observed = []
    for test in tests:
        each = -values[test.node][test.numbers]
        observed.append((method.proposal_at(test.node, ()), Observation(float(each.mean()), tuple(each.tolist()))))
    return method.bound_after(observed)


def _claim(bound: Bound) -> float:
    assert bound.upper is not None
    return -bound.upper


@dataclass(frozen=True, slots=True)
class Worst:
    """What the record says of its worst point, each with its standard error; points that are compared favour it."""

    x: tuple[float, ...]
    risk: float
    observed: float
    """The least mean of X: no bound of the method is above it, whatever the norm."""
    error: float
    points: int
    """Of the record."""


def worst(subject: Subject, recorded: Recorded) -> Worst:
    """Return risk and mean of X at the point of the record whose risk is least."""
    weight = subject.plan.risk_weight
    risks = {node: float(each.mean() - weight * each.std(ddof=1)) for node, each in recorded.robustness.items()}
    node = min(risks, key=lambda each: risks[each])
    values = observed(subject, recorded.robustness[node])
    x = tuple(subject.lattice.nodes[node].tolist())
    return Worst(x, risks[node], float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values))), len(risks))

"""Campaigns of methods `kriging`, `scenario` and `sample` with a control, of rollouts that leave nothing to spare."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, get_args

import numpy as np

from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod, Terms
from perfbound.orchestrator.mathematics.bounds.scenario import ScenarioMethod
from perfbound.orchestrator.mathematics.control.basis import choice_basis, normal_basis
from perfbound.orchestrator.mathematics.control.sequence import Disturbed as Known
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import SampledQuantity
from tests.studies.coverage.controls.disturbed import DISTURBED, MEAN, RARE, RISK_WEIGHT, Disturbed, Floats, draw
from tests.studies.coverage.oracle import ROUNDING

Bounds = Literal["kriging", "scenario", "mean", "risk", "CVaR"]
"""The last three are of method `sample`."""
CLIP, NORM = (0.0, 1.0), 0.1
TESTS, REPLICATES = 64, 8
TRUTH = 1e-6
"""By which the moments of a law may be wrong."""
QUANTITIES: dict[Bounds, SampledQuantity] = {"mean": "mean", "risk": "risk", "CVaR": "cvar"}


@dataclass(frozen=True)
class Controls:
    """One row: 512 rollouts, whose bound is stopped at the worst moment."""

    kind: ClassVar[str] = "controls"
    bounds: Bounds
    disturbances: str
    delta: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims."""
        return self.delta

    @property
    def tests(self) -> int:
        """Number of tests, of REPLICATES rollouts each."""
        return TESTS

    @property
    def law(self) -> Disturbed:
        """The rollouts."""
        return DISTURBED[self.disturbances]


def rows() -> Iterator[Controls]:
    """Every bound with all that disturbances may do."""
    for bounds in get_args(Bounds):
        for name in DISTURBED:
            yield Controls(bounds, name)


Method = KrigingMethod | ScenarioMethod | SampleMethod
BASES = (normal_basis(7), choice_basis((RARE, 1.0 - RARE)))


def campaign(row: Controls, rng: np.random.Generator, *, told: float | None = None) -> dict[str, float]:
    """Run one campaign, whose method may get another delta, and return what was false at any time.

    `lower`: what the rollouts prove of the mean or risk; `upper`: the bound from the other side, or the audit of B.
    """
    delta, scores = told or row.delta, list[Floats]()
    width = 1 if row.bounds in QUANTITIES else REPLICATES
    known = Known(BASES, lambda test, _: scores[test], row.tests * REPLICATES)
    method, law, aim = method_of(row, delta, known), row.law, aim_of(row)
    lower = refuted = False
    for test in range(row.tests):
        drawn = draw(rng, REPLICATES)
        scores.extend(drawn.reshape(-1, width, 2))
        each = law.value(drawn, rng, _side(method)).reshape(-1, width)
        nodes = np.zeros(len(each), dtype=np.int64)
        if not isinstance(method, KrigingMethod):
            method.recall_each(nodes, np.zeros(len(each)), each)
            continue
        nodes += method.design.nodes[method.design.order[test]]
        refuted = method.observe_each(nodes, np.zeros(1), -each).verdict == "refuted"
        if refuted:  # it ends the campaign, whose claim is the bound before
            break
        sums = method.bets.bounds
        lower |= bool((sums._sum + math.log(delta) > sums._weights.sum(axis=1) * MEAN + ROUNDING).any())
    bound, upper = bounds_of(method)
    return {
        "lower": lower or bound > aim + ROUNDING,
        "upper": refuted or upper < MEAN - ROUNDING,
        "used": method.control is not None,
        "width": aim - bound,
    }


def method_of(row: Controls, delta: float, known: Known) -> Method:
    """Return the method of a row, before its first test."""
    match row.bounds:
        case "kriging":
            # m0 - B everywhere: the assumption proves it, and the rollouts leave least to spare.
            premises = KrigingPremises(NORM, -(MEAN + NORM), (-1.0, 0.0), delta)
            budget = KrigingBudget(row.tests, REPLICATES, 3)
            lattice, kernel = Lattice((0.0,), (1.0,), 5), Matern(2.5, 1e4)
            return KrigingMethod(lattice, kernel, premises, spread=0.2, budget=budget, disturbed=known)
        case "scenario":
            return ScenarioMethod(
                Points(((0.0,),)),
                clip=CLIP,
                risk_weight=RISK_WEIGHT,
                delta=delta,
                alpha=1e-6,
                risk="mean",
                disturbed=known,
            )
        case _:
            level = 0.5 if row.bounds == "CVaR" else 1.0
            terms = Terms(QUANTITIES[row.bounds], delta, level, clip=CLIP, risk_weight=RISK_WEIGHT, disturbed=known)
            return SampleMethod([terms], lambda _: (0.0,), fixed=None, largest=False)


@cache
def aim_of(row: Controls) -> float:
    """Return what the bound must not exceed."""
    if row.bounds == "CVaR":
        return row.law.worst_half() + TRUTH
    return row.law.risk() + TRUTH if row.bounds == "risk" else MEAN


def _side(method: Method) -> int:
    """Return the side of the adversary: against the slope of the control that the next rollouts get."""
    if method.control is None:
        return 1
    (levels, *_), _ = method.control[0].levels
    return -1 if levels[-1] > levels[0] else 1


def bounds_of(method: Method) -> tuple[float, float]:
    """Return the bound, and that from the other side."""
    if isinstance(method, ScenarioMethod):
        found = method.bound()
        return found.ell, found.upper
    if isinstance(method, SampleMethod):
        bound = method.found(0)
        assert bound is not None
        return bound, math.inf
    bound = method.bound_after([]).upper
    assert bound is not None
    return -bound, math.inf

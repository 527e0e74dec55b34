"""Campaigns of method `scenario`.

Every bound is a running extremum, so that it failed at some time if and only if it fails at the end: what is counted is
failure *ever*. It is counted against min_k E[X_k] (phi(min_k E rho_k) for `bhatia-davis`, min_k E rho_k for `mean`),
which is not above rho*: a bound above rho* is counted too, and a bound between the two although its claim holds. For
`predictable` it is rho* itself.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.scenario import Risk, ScenarioMethod
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation
from tests.studies.coverage.laws import CLIP, CONSTANTS, LAWS, RISK_WEIGHT, Law, extreme_risk
from tests.studies.coverage.oracle import ROUNDING

REPLICATES = 5


@dataclass(frozen=True)
class Scenario:
    """One row: `size` starts, all with the worst law (tied) or one of them."""

    kind: ClassVar[str] = "scenario"
    law: str = "two points"
    tied: bool = True
    size: int = 4
    window: int = 1
    risk: Risk = "linearised"
    tests: int = 30
    delta: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims."""
        return self.delta


def rows() -> Iterator[Scenario]:
    """Every law with ties and without, one start, four and 25, both windows, both readings of the risk, the mean."""
    for law in LAWS:
        yield Scenario(law, tied=True, size=1, window=1)
        yield Scenario(law, tied=True, size=4, window=8)
        yield Scenario(law, tied=False, size=4, window=1)
        yield Scenario(law, tied=False, size=4, window=8, risk="bhatia-davis")
    yield Scenario("two points", tied=True, size=1, window=8, risk="bhatia-davis")
    yield Scenario("skewed", tied=True, size=25, window=8, tests=60)
    yield Scenario("two points", tied=False, size=25, window=1, tests=60)
    yield Scenario("Gaussian, clipped", tied=True, size=25, window=1, risk="bhatia-davis", tests=60)
    yield Scenario("two points", tied=True, size=1, window=8, risk="mean")
    yield Scenario("skewed", tied=False, size=4, window=1, risk="mean")
    for law in LAWS:
        yield Scenario(law, tied=law == "skewed", size=4, window=8, risk="predictable")


@cache
def targets(row: Scenario) -> tuple[tuple[Law, ...], tuple[float, ...]]:
    """Return the laws of the starts, and what each start's bound must not exceed."""
    worst, other = LAWS[row.law]
    laws = (worst, *((worst if row.tied else other,) * (row.size - 1)))
    aims: dict[Risk, Callable[[Law], float]] = {
        "linearised": lambda law: law.linearised,
        "bhatia-davis": lambda law: float(extreme_risk(law.mean)),
        "mean": lambda law: law.mean,
        "predictable": lambda law: law.mean - RISK_WEIGHT * law.sd,
    }
    return laws, tuple(aims[row.risk](law) for law in laws)


def campaign(row: Scenario, rng: np.random.Generator, *, told: float | None = None) -> dict[str, float]:
    """Run one campaign, whose method may get another delta, and return which of its three claims were ever false."""
    laws, aims = targets(row)
    method = ScenarioMethod(
        Points(tuple((float(k),) for k in range(row.size))),
        clip=CLIP,
        risk_weight=RISK_WEIGHT,
        delta=told or row.delta,
        alpha=0.15,
        risk=row.risk,
        constants=CONSTANTS if row.risk == "linearised" else None,
    )
    flying: deque[int] = deque()
    for _ in range(row.tests):
        while len(flying) < row.window:
            flying.append(method.propose(pending=flying).node)
        index = flying.popleft()
        method.observe(*an_observation(index, laws[index].draw(rng, REPLICATES).tolist()))
        if method.stops():
            break
    bound, least = method.bound(), min(aims)
    found = {
        "ell": bound.ell > least + ROUNDING,
        "each": any(
            state.simultaneous_lower > aim + ROUNDING for state, aim in zip(bound.scenarios, aims, strict=True)
        ),
        # With constants from the past it bounds the least mean.
        "upper": bound.upper < (min(law.mean for law in laws) if row.risk == "predictable" else least) - ROUNDING,
    }
    return {**found, "converged": method.stops(), "tests": method.n, "width": least - bound.ell}

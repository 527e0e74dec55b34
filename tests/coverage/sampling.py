"""Campaigns of method `sample`: independent draws from a law with a known truth, and one bound of it.

All anytime bounds are running extremes, so that a claim failed at some time if and only if it fails at the end: no stop
that depends on outcomes can be worse. Bounds for a fixed number of samples are judged at this number.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.failures import FailureSequence, QuantileSequence
from perfbound.orchestrator.mathematics.bounds.predictable import CvarSequence, RiskSequence
from perfbound.orchestrator.mathematics.bounds.share import (
    clopper_pearson_lower,
    clopper_pearson_upper,
    next_rollout_rank,
    quantile_rank,
)
from tests.coverage.laws import CLIP, RISK_WEIGHT, SAMPLED, Floats, Sampled
from tests.coverage.oracle import ROUNDING

GRID = tuple((np.arange(-400, 201) / 20).tolist())


@dataclass(frozen=True)
class Sampling:
    """One row: a claim about a law; the failure of a sample is a value below 0."""

    kind: ClassVar[str] = "sampling"
    law: str
    claim: str
    samples: int
    share: float = 0.1
    delta: float = 0.05

    @property
    def claimed(self) -> float:
        """The failure probability that the bound claims."""
        return self.delta


def rows() -> Iterator[Sampling]:
    """Every claim with the laws that are hard for it."""
    for law in ("uniform, fine atoms", "rare failures", "nearly always failing", "two points"):
        for claim in ("failures, upper", "failures, lower", "failures, fixed n, upper", "failures, fixed n, lower"):
            yield Sampling(law, claim, 600)
    for law in ("uniform, fine atoms", "heavy atoms", "a jump at the tenth", "normal", "Cauchy"):
        for claim in ("quantile", "quantile, fixed n", "next rollout"):
            yield Sampling(law, claim, 600)
    for law, sampled in SAMPLED.items():
        if sampled.bounded:
            yield Sampling(law, "CVaR", 150)
            yield Sampling(law, "CVaR", 150, share=0.5)
            yield Sampling(law, "mean", 150)
            yield Sampling(law, "risk", 150)


def campaign(row: Sampling, rng: np.random.Generator) -> dict[str, float]:
    """Run one campaign; `width` is the distance of the bound from the truth, infinite without a bound."""
    law = SAMPLED[row.law]
    values = law.draw(rng, row.samples + 1)
    bound, truth, upper = CLAIMS[row.claim](row, law, values)
    loss = (bound - truth) if upper else (truth - bound)
    return {"false": loss < -ROUNDING, "width": loss}


Outcome = tuple[float, float, bool]
"""The bound, the truth, and whether the bound is an upper one."""


def _failures(row: Sampling, law: Sampled, values: Floats, *, upper: bool) -> Outcome:
    bounds = FailureSequence(delta=row.delta)
    for value in values[:-1].tolist():
        bounds.add(value < 0)
    return (bounds.upper() if upper else bounds.lower()), law.failure, upper


def _fixed_failures(row: Sampling, law: Sampled, values: Floats, *, upper: bool) -> Outcome:
    bound = clopper_pearson_upper if upper else clopper_pearson_lower
    return bound(int((values[:-1] < 0).sum()), row.samples, row.delta), law.failure, upper


def _quantile(row: Sampling, law: Sampled, values: Floats) -> Outcome:
    bound = QuantileSequence(row.share, GRID, delta=row.delta)
    for value in values[:-1].tolist():
        bound.add(value)
    found = bound.lower()
    return (-math.inf if found is None else found), law.tenth, False


def _fixed_quantile(row: Sampling, law: Sampled, values: Floats) -> Outcome:
    rank = quantile_rank(row.samples, row.share, row.delta)
    assert rank is not None
    return float(np.sort(values[:-1])[rank - 1]), law.tenth, False


def _next_rollout(row: Sampling, law: Sampled, values: Floats) -> Outcome:
    rank = next_rollout_rank(row.samples, row.delta)
    assert rank is not None
    return float(np.sort(values[:-1])[rank - 1]), float(values[-1]), False


def _cvar(row: Sampling, law: Sampled, values: Floats) -> Outcome:
    bound = CvarSequence(row.share, CLIP, delta=row.delta)
    for value in values[:-1].tolist():
        bound.add(value)
    return bound.lower(), law.cvar(row.share), False


def _risk(row: Sampling, law: Sampled, values: Floats, *, risk_weight: float) -> Outcome:
    bound = RiskSequence(risk_weight, CLIP, delta=row.delta)
    for value in values[:-1].tolist():
        bound.add(value)
    return bound.lower(), law.risk(risk_weight), False


CLAIMS: dict[str, Callable[[Sampling, Sampled, Floats], Outcome]] = {
    "failures, upper": lambda *given: _failures(*given, upper=True),
    "failures, lower": lambda *given: _failures(*given, upper=False),
    "failures, fixed n, upper": lambda *given: _fixed_failures(*given, upper=True),
    "failures, fixed n, lower": lambda *given: _fixed_failures(*given, upper=False),
    "quantile": _quantile,
    "quantile, fixed n": _fixed_quantile,
    "next rollout": _next_rollout,
    "CVaR": _cvar,
    "mean": lambda *given: _risk(*given, risk_weight=0.0),
    "risk": lambda *given: _risk(*given, risk_weight=RISK_WEIGHT),
}

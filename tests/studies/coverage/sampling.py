"""Campaigns of method `sample`: independent draws from a law with a known truth, and one claim about it.

All anytime bounds are running extremes, so that a claim failed at some time if and only if it fails at the end: no stop
that depends on outcomes can be worse. Bounds for a fixed number of samples are judged at this number.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod, Terms
from perfbound.schemas.values import Observation, Proposal, SampledQuantity
from tests.studies.coverage.laws import CLIP, RISK_WEIGHT, SAMPLED, Floats
from tests.studies.coverage.oracle import ROUNDING

WIDE = (-20.0, 10.0)
"""The clip of laws without bounds, where a quantile is bounded after every sample."""
STARTS = np.array([0.1, 0.45, 0.6])
"""Means of the rollouts at three kinds of starts, whose shares are .1, .3 and .6."""
SHARES = (0.1, 0.3, 0.6)
ROLLOUTS = 4
"""Of one start, each at an end of the clip: no law with its mean has more noise."""


@dataclass(frozen=True)
class Sampling:
    """One row: a claim about a law; the failure of a sample is a value below 0."""

    kind: ClassVar[str] = "sampling"
    law: str
    claim: str
    samples: int
    level: float = 0.1
    ratio: float = 1.0
    delta: float = 0.05

    @property
    def claimed(self) -> float:
        """The failure probability that the bound claims."""
        return self.delta


QUANTITIES: dict[str, SampledQuantity] = {
    "failures": "failure_probability",
    "quantile": "quantile",
    "next rollout": "next_rollout",
    "CVaR": "cvar",
    "mean": "mean",
    "risk": "risk",
    "share of starts": "share_of_starts",
}


def rows() -> Iterator[Sampling]:
    """Every claim with the laws that are hard for it; those with `fixed n` are judged at their number alone."""
    for law in ("uniform, fine atoms", "rare failures", "nearly always failing", "two points"):
        for claim in ("failures, upper", "failures, lower", "failures, fixed n, upper", "failures, fixed n, lower"):
            yield Sampling(law, claim, 600)
    for law in ("uniform, fine atoms", "heavy atoms", "a jump at the tenth", "normal", "Cauchy"):
        for claim in ("quantile", "quantile, fixed n", "next rollout, fixed n"):
            yield Sampling(law, claim, 600)
        yield Sampling(law, "share of starts, fixed n", 600)
    yield Sampling("three kinds of starts", "share of starts", 150)
    yield Sampling("a jump at the tenth", "quantile, fixed n", 600, level=0.2, ratio=2.0)
    for law, sampled in SAMPLED.items():
        if sampled.bounded:
            yield Sampling(law, "CVaR", 150)
            yield Sampling(law, "CVaR", 150, level=0.5)
            yield Sampling(law, "mean", 150)
            yield Sampling(law, "mean", 150, ratio=2.0)
            yield Sampling(law, "risk", 150)


def campaign(row: Sampling, rng: np.random.Generator) -> dict[str, float]:
    """Run one campaign; `width` is the distance of the bound from the truth, infinite without a bound."""
    values = _values(row, rng)
    upper = row.claim.endswith("upper")
    bound, truth = _bound(row, values[:-1]), _truth(row, values)
    loss = (bound - truth) if upper else (truth - bound)
    return {"false": loss < -ROUNDING, "width": loss}


def _values(row: Sampling, rng: np.random.Generator) -> Floats:
    """Return the robustness of every start and of one more, (n + 1, b)."""
    if row.law in SAMPLED:
        return SAMPLED[row.law].draw(rng, row.samples + 1)[:, None]
    means = rng.choice(STARTS, row.samples + 1, p=SHARES)
    low, high = CLIP
    at_high = rng.uniform(size=(row.samples + 1, ROLLOUTS)) < ((means - low) / (high - low))[:, None]
    return np.where(at_high, high, low)


def _bound(row: Sampling, values: Floats) -> float:
    name, _, form = row.claim.partition(", ")
    fixed = form.startswith("fixed n")
    unbounded = row.law in SAMPLED and not SAMPLED[row.law].bounded
    # An exact quantile needs no clip; every other value is clipped.
    clip = (None if fixed else WIDE) if unbounded else CLIP
    if clip is not None:
        values = np.clip(values, *clip)
    terms = Terms(
        QUANTITIES[name],
        row.delta,
        level=_level(row),
        ratio=row.ratio,
        clip=clip,
        risk_weight=RISK_WEIGHT,
        deterministic=row.law in SAMPLED,
    )
    number = len(values) if fixed else None
    method = SampleMethod([terms], lambda _: (0.0,), fixed=number, largest=name == "failures")
    start = Proposal(0, (0.0,), None, None, None, None)
    tests = [(start, Observation(0.0, tuple(map(float, each)))) for each in values]
    method.recall(tests[:-1])
    last = method.observe(*tests[-1])
    found = last.lower if form.endswith("lower") else method.found(0)
    return -math.inf if found is None else found


def _level(row: Sampling) -> float:
    if row.claim in {"mean", "risk"} or row.claim.startswith("failures"):
        return 1.0
    return row.delta if row.claim.startswith("next rollout") else row.level


def _truth(row: Sampling, values: Floats) -> float:
    """Return what the claim is about; of a factor that of the worst distribution within it."""
    if row.law not in SAMPLED:
        # A bound up to the second mean is right: only the share .1 of the starts is below it.
        return float(STARTS[1])
    law, name = SAMPLED[row.law], row.claim.partition(",")[0]
    match name:
        case "failures":
            return law.failure
        case "next rollout":
            return float(values[-1, 0])
        case "CVaR":
            return law.cvar(row.level)
        case "mean":
            return law.cvar(1 / row.ratio)
        case "risk":
            return law.risk(RISK_WEIGHT)
        case _:
            return law.tenth  # also of the level .2 within the factor 2

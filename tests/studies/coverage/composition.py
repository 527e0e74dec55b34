"""Campaigns of two problems, nominal robustness and signed gap, and the bound of the true risk that follows.

The true robustness at d takes the two ends of the clip only, with mean nominal(d) - gap(d): of all laws with this mean
none has a lower risk, so that the step from the mean to the risk has nothing to spare.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.composition import (
    compose_mean,
    derived_noise_scale,
    least_risk,
    pointwise_mean,
)
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import ExhaustedError, RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from tests.fakes.observations import an_observation
from tests.studies.coverage.functions import Floats, fine_points, maximum, random_function
from tests.studies.coverage.laws import CLIP, RISK_WEIGHT, draw_extremes, extreme_risk
from tests.studies.coverage.oracle import ROUNDING
from tests.studies.coverage.rigorous import LENGTHS, candidates

LOOKS = 3
"""Number of checks of the composed bounds in a campaign."""
NOMINAL, NOMINAL_NORM = 0.55, 0.15
GAP, GAP_NORM = 0.05, 0.1


@dataclass(frozen=True)
class Composition:
    """One row: both problems take turns; the nominal system may be noisy (clip ends, too)."""

    kind: ClassVar[str] = "composition"
    place: str = "box"
    dimension: int = 2
    nu: float = 2.5
    noisy_nominal: bool = False
    replicates: int = 64
    tests: int = 12
    delta: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability of a composed claim: the sum over the problems that have noise."""
        return self.delta * (2 if self.noisy_nominal else 1)


def rows() -> Iterator[Composition]:
    """Boxes and lists, one and two dimensions, a nominal system with and without noise."""
    for place, (dimension, nu), noisy in product(("box", "list"), ((1, 2.5), (2, 1.5)), (False, True)):
        yield Composition(place, dimension, nu, noisy)


class Pair:
    """One campaign's truth and its two methods."""

    def __init__(self, row: Composition, rng: np.random.Generator) -> None:
        length, nu = LENGTHS[row.dimension], row.nu
        f, g = (
            random_function(rng, row.dimension, nu=nu, length_scale=length, norm=norm)
            for norm in (NOMINAL_NORM, GAP_NORM)
        )
        self.candidates = candidates(rng, row.place, row.dimension)
        nodes = self.candidates.nodes
        self.nominal: Floats = NOMINAL + f(nodes)
        self.mean: Floats = self.nominal - GAP - g(nodes)
        points = fine_points(rng, row.dimension, f, g) if row.place == "box" else nodes

        def risk(z: Floats) -> Floats:
            return extreme_risk(NOMINAL - GAP + f(z) - g(z))

        self.least = -maximum(lambda z: -risk(z), points) if row.place == "box" else float(risk(nodes).min())
        noises = [
            derived_noise_scale(kind, CLIP, deterministic_nominal=not row.noisy_nominal, common_seeds=False)
            / row.replicates**0.5
            for kind in ("nominal_robustness", "robustness")
        ]
        self.methods = [
            RigorousMethod(
                self.candidates,
                Matern(nu, length),
                Premises(norm, noise, row.delta, mixture(norm, noise)),
                alpha=0.02,
                prior_mean=mean,
            )
            for norm, noise, mean in zip((NOMINAL_NORM, GAP_NORM), noises, (-NOMINAL, GAP), strict=True)
        ]


def campaign(row: Composition, rng: np.random.Generator) -> dict[str, float]:
    """Run both problems side by side and compare every composed bound with the true least risk, LOOKS times."""
    pair = Pair(row, rng)
    wrong = dict.fromkeys(("extremes", "popoviciu", "pointwise"), False)
    claims: dict[str, float] = {}
    for test in range(row.tests):
        for which in (0, 1):
            _step(pair, which, row, rng)
        if (test + 1) % (row.tests // LOOKS) == 0:
            claims = _claims(pair)
            wrong = {name: wrong[name] or claims[name] > pair.least + ROUNDING for name in wrong}
    refuted = any(method.bound().status == "refuted" for method in pair.methods)
    loss = pair.least - claims["pointwise"]
    return {"failed": refuted or any(wrong.values()), **wrong, "refuted": refuted, "width": loss}


def _step(pair: Pair, which: int, row: Composition, rng: np.random.Generator) -> None:
    """Make the next test of one problem, unless it is done."""
    method = pair.methods[which]
    if method.bound().status != "open":
        return
    first = None if method.bound().n else int(rng.integers(pair.candidates.size))
    try:
        index = method.propose(first).node
    except ExhaustedError:  # without noise: the rest is between the candidates
        return
    nominal = float(pair.nominal[index])
    if row.noisy_nominal:
        nominal = float(draw_extremes(rng, nominal, row.replicates).mean())
    gap = nominal - float(draw_extremes(rng, float(pair.mean[index]), row.replicates).mean())
    method.observe(*an_observation(index, gap if which else -nominal))


def _claims(pair: Pair) -> dict[str, float]:
    """Return ell by every rule."""
    nominal, gap = pair.methods
    mean = compose_mean(-nominal.bound().upper, gap.bound().upper, kind="robustness", clip=CLIP)
    better = mean
    if all(method.bound().status != "refuted" for method in pair.methods):
        better = pointwise_mean(nominal.envelope, gap.envelope, pair.candidates, clip=CLIP, slack=0.005, extremes=mean)
    return {
        "extremes": least_risk(mean, risk_weight=RISK_WEIGHT, clip=CLIP, variance="bhatia-davis"),
        "popoviciu": least_risk(mean, risk_weight=RISK_WEIGHT, clip=CLIP, variance="popoviciu"),
        "pointwise": least_risk(better, risk_weight=RISK_WEIGHT, clip=CLIP, variance="bhatia-davis"),
    }

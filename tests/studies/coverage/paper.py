"""Contrast: campaigns of method `paper`, with B right and with B too small, on both readings of sigma.

Nothing here is required to hold: the premises of some rows are false on purpose.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.checks import audit
from perfbound.orchestrator.mathematics.bounds.composition import compose
from perfbound.orchestrator.mathematics.bounds.paper.formulas import PaperParameters, SigmaReading, mills_probability
from perfbound.orchestrator.mathematics.bounds.paper.method import PaperMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation
from tests.studies.coverage.composition import GAP, GAP_NORM, NOMINAL, NOMINAL_NORM
from tests.studies.coverage.functions import SIDE, Floats, Known, fine_points, maximum, random_function
from tests.studies.coverage.laws import CLIP, RISK_WEIGHT, extreme_risk
from tests.studies.coverage.oracle import ROUNDING

NU, LENGTH, RESOLUTION, MAX_TESTS, DELTA = 2.5, 1.5, 16, 100, 0.05
NOISE, MARGIN, TOLERANCE = 0.0035, 2.0, 0.01
"""R and alpha in units of the true norm, c in units of R: about those of the paper's test function."""


@dataclass(frozen=True)
class Paper:
    """One row: J has norm 1, the method gets 1/`small_b`; `composed` is Theorem 2, probabilities multiplied."""

    kind: ClassVar[str] = "paper"
    small_b: float = 1.0
    sigma: SigmaReading = "variance"
    composed: bool = False

    @property
    def claimed(self) -> float:
        """1 - Delta, or 1 - Delta^2."""
        chance = mills_probability(MARGIN * NOISE, DELTA, NOISE, "gaussian")
        return 1.0 - chance ** (2 if self.composed else 1)


def rows() -> Iterator[Paper]:
    """One problem as printed and with sigma as a standard deviation; Theorem 2 as printed."""
    sigmas: tuple[SigmaReading, ...] = ("variance", "std")
    for sigma, small_b in product(sigmas, (1.0, 2.0, 4.0)):
        yield Paper(small_b, sigma)
    for small_b in (1.0, 4.0):
        yield Paper(small_b, composed=True)


@cache
def lattice() -> Lattice:
    """Return the nodes on which proposals are made."""
    return Lattice((0.0, 0.0), (SIDE, SIDE), RESOLUTION)


@dataclass(frozen=True)
class Outcome:
    """Result of one problem."""

    epsilon: float
    tests: int
    converged: bool
    refuted: bool


def problem(row: Paper, rng: np.random.Generator, values: Floats, norm: float, prior_mean: float) -> Outcome:
    """Run Algorithm 1 on J = `values` at the nodes until it stops or its budget ends."""
    told, noise = norm / row.small_b, NOISE * norm
    parameters = PaperParameters(
        rkhs_norm=told,
        noise_scale=noise,
        delta=DELTA,
        alpha=TOLERANCE * norm,
        c=MARGIN * noise,
        prior_mean=prior_mean,
        sigma=row.sigma,
    )
    method = PaperMethod(lattice(), Matern(NU, LENGTH), parameters)
    proposal = method.propose(int(rng.integers(lattice().size)))
    seen: list[float] = []
    while True:
        seen.append(float(values[proposal.node]) + float(rng.normal(0.0, noise)))
        method.observe(*an_observation(proposal.node, seen[-1]))
        if method.stops(proposal) or method.n == MAX_TESTS:
            break
        proposal = method.propose()
    checked = audit.norm_from_tests(seen, prior_mean=prior_mean, rkhs_norm=told, noise_scale=noise, delta=DELTA)
    return Outcome(method.epsilon(proposal, seen[-1]), method.n, method.stops(proposal), checked.status == "refuted")


def campaign(row: Paper, rng: np.random.Generator) -> dict[str, float]:
    """Run one campaign; return whether its claim is false, and whether its audit refuted B."""
    return _composed(row, rng) if row.composed else _single(row, rng)


def _single(row: Paper, rng: np.random.Generator) -> dict[str, float]:
    j = _function(rng, 1.0)
    values = j(lattice().nodes)
    found = problem(row, rng, values, 1.0, 0.0)
    top = maximum(j, fine_points(rng, 2, j))
    return _counts(found.epsilon - top, found.epsilon - float(values.max()), (found,))


def _composed(row: Paper, rng: np.random.Generator) -> dict[str, float]:
    f, g = _function(rng, NOMINAL_NORM), _function(rng, GAP_NORM)
    nodes = lattice().nodes
    nominal = problem(row, rng, -(NOMINAL + f(nodes)), NOMINAL_NORM, -NOMINAL)
    gap = problem(row, rng, GAP + g(nodes), GAP_NORM, GAP)

    def minus_risk(z: Floats) -> Floats:
        return -extreme_risk(NOMINAL - GAP + f(z) - g(z))

    least, on_nodes = -maximum(minus_risk, fine_points(rng, 2, f, g)), -float(minus_risk(nodes).max())
    chance = mills_probability(MARGIN * NOISE, DELTA, NOISE, "gaussian")
    ell = compose(
        -nominal.epsilon,
        gap.epsilon,
        lipschitz=1.0,
        risk_weight=RISK_WEIGHT,
        clip=CLIP,
        probabilities=(chance, chance),
        rule="product",
    ).ell
    return _counts(least - ell, on_nodes - ell, (nominal, gap))


def _function(rng: np.random.Generator, norm: float) -> Known:
    return random_function(rng, 2, nu=NU, length_scale=LENGTH, norm=norm)


def _counts(margin: float, on_nodes: float, outcomes: tuple[Outcome, ...]) -> dict[str, float]:
    """Judge the claim about the box, and the same claim about the nodes alone, where tests were possible."""
    refuted = any(outcome.refuted for outcome in outcomes)
    wrong = margin < -ROUNDING
    return {
        "bound": wrong,
        "nodes": on_nodes < -ROUNDING,
        "refuted": refuted,
        "unnoticed": wrong and not refuted,
        "converged": all(outcome.converged for outcome in outcomes),
        "tests": max(outcome.tests for outcome in outcomes),
        "width": margin,
    }

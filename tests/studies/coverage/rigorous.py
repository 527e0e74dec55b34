"""Campaigns of method `rigorous`, with the right premises and with wrong ones (the audit)."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle, product
from typing import ClassVar

import numpy as np

from perfbound.orchestrator.mathematics.bounds.checks import audit
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture, radius
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from tests.fakes.observations import an_observation
from tests.studies.coverage.functions import SIDE, Floats, Known, fine_points, maximum, random_function
from tests.studies.coverage.noises import NOISES
from tests.studies.coverage.oracle import ROUNDING, outside

NORM = 1.0
LENGTHS = {1: 1.0, 2: 1.5, 3: 2.5}
RESOLUTIONS = {1: 11, 2: 5, 3: 3}
TESTS = {"box": {1: 15, 2: 12, 3: 8}, "list": {1: 20, 2: 20, 3: 20}}
"""Covering a box is what costs time."""
LISTED = 25
"""Points of a finite list."""

Counts = dict[str, float]


@dataclass(frozen=True)
class Rigorous:
    """One row: J has norm NORM exactly, the noise has scale `noise_scale`; the premises of the method may differ."""

    kind: ClassVar[str] = "rigorous"
    place: str = "box"
    dimension: int = 2
    nu: float = 2.5
    noise: str = "Gaussian"
    window: int = 1
    noise_scale: float = 0.2
    tests: int = 20
    delta: float = 0.1
    alpha: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims."""
        return self.delta if self.noise_scale > 0 else 0.0


@dataclass(frozen=True)
class Audit:
    """One row: the same, with the premises NORM/`small_b` and `noise_scale`/`small_r`, and with replicates."""

    kind: ClassVar[str] = "audit"
    small_b: float = 1.0
    small_r: float = 1.0
    noise_scale: float = 0.2
    replicates: int = 4
    tests: int = 20
    delta: float = 0.1

    @property
    def claimed(self) -> float:
        """The failure probability that the method claims."""
        return self.delta


def rows() -> Iterator[Rigorous]:
    """Every dimension with every nu, over a box and over a list; noises and windows in turn."""
    turns = cycle(product(NOISES, (1, 8)))
    for place, dimension, nu in product(("box", "list"), LENGTHS, (0.5, 1.5, 2.5)):
        noise, window = next(turns)
        yield Rigorous(place, dimension, nu, noise, window, tests=TESTS[place][dimension])
    for noise, window in zip(NOISES, (1, 8, 8, 1), strict=True):  # noise as large as J: the least to spare
        yield Rigorous("list", 2, 1.5, noise, window, noise_scale=1.0, delta=0.5)
    yield Rigorous("list", 2, 1.5, "Gaussian", 1, noise_scale=1.0)
    yield Rigorous("list", 2, 1.5, "+-R", 8, noise_scale=1.0)
    yield Rigorous("box", 1, 2.5, "Gaussian", 1, noise_scale=0.02, alpha=0.3)  # stops by convergence
    yield Rigorous("list", 2, 1.5, "+-R", 8, noise_scale=0.02, alpha=0.3)
    yield Rigorous("box", 1, 2.5, "Gaussian", 1, noise_scale=0.0, tests=10)
    yield Rigorous("box", 2, 1.5, "Gaussian", 8, noise_scale=0.0, tests=15)
    yield Rigorous("list", 3, 0.5, "Gaussian", 1, noise_scale=0.0)


def audits() -> Iterator[Audit]:
    """The power curve at two noise scales, and noise scales that are too small."""
    for noise_scale, small_b in product((0.2, 0.02), (1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)):
        yield Audit(small_b=small_b, noise_scale=noise_scale)
    for small_r in (2.0, 4.0):
        yield Audit(small_r=small_r)


def candidates(rng: np.random.Generator, place: str, dimension: int) -> Lattice | Points:
    """Return the lattice of a box, or a list of random points."""
    if place == "box":
        return Lattice((0.0,) * dimension, (SIDE,) * dimension, RESOLUTIONS[dimension])
    return Points(tuple(tuple(point) for point in rng.uniform(0.0, SIDE, (LISTED, dimension)).tolist()))


class Setting:
    """One campaign's truth: the function, where it is tested, and its maximum."""

    def __init__(self, rng: np.random.Generator, place: str, dimension: int, nu: float) -> None:
        self.kernel = Matern(nu, LENGTHS[dimension])
        self.j: Known = random_function(rng, dimension, nu=nu, length_scale=LENGTHS[dimension], norm=NORM)
        self.candidates = candidates(rng, place, dimension)
        self.values: Floats = self.j(self.candidates.nodes)
        self.points = fine_points(rng, dimension, self.j) if place == "box" else self.candidates.nodes
        self.fine: Floats = self.j(self.points)
        self.top = maximum(self.j, self.points) if place == "box" else float(self.values.max())


def method(setting: Setting, premises: Premises, alpha: float) -> RigorousMethod:
    """Return the method with the premises of the row."""
    return RigorousMethod(
        setting.candidates,
        setting.kernel,
        premises,
        alpha=alpha,
    )


def places(told: RigorousMethod, rng: np.random.Generator, size: int, window: int) -> Iterator[int]:
    """Propose with `window` tests in flight until the method is done; yield the place whose result is due."""
    flying = [told.propose(int(rng.integers(size))).node]
    while told.bound().status == "open":
        while len(flying) < window:
            flying.append(told.propose(None, flying).node)
        yield flying.pop(0)


def campaign(row: Rigorous, rng: np.random.Generator, *, told_delta: float | None = None) -> Counts:
    """Run one campaign, whose method may get another delta, and return what was false at any time.

    `set`: J is not in the confidence set, the sum of (J(z_i) - y_i)^2 being above Q. Everything else follows from that
    set, so this is the statement that has least to spare.
    """
    truth = Setting(rng, row.place, row.dimension, row.nu)
    premises = Premises(NORM, row.noise_scale, told_delta or row.delta, mixture(NORM, row.noise_scale))
    told = method(truth, premises, row.alpha)
    past: list[float] = []
    band = left = False
    for _, index in zip(range(row.tests), places(told, rng, len(truth.values), row.window), strict=False):
        error = NOISES[row.noise](rng, row.noise_scale, index, past) if row.noise_scale else 0.0
        told.observe(*an_observation(index, float(truth.values[index]) + error))
        past.append(error)
        upper, lower = told.envelope.at(truth.points)
        band |= outside(truth.fine, lower, upper)
        left |= float(np.square(past).sum()) > radius(told.envelope.spectrum, premises) * (1.0 + ROUNDING)
    bound = told.bound()
    wrong = wrong_bound(told, truth)
    refuted = bound.status == "refuted"
    return {
        "failed": left or band or wrong or refuted,
        "set": left,
        "band": band,
        "bound": wrong,
        "refuted": refuted,
        "converged": bound.status == "converged",
        "tests": told.bound().n,
        "width": bound.upper - bound.lower,
    }


def wrong_bound(told: RigorousMethod, truth: Setting) -> bool:
    """Return whether U or L was ever on the wrong side: both are running extremes, so the last ones decide."""
    bound = told.bound()
    return not bound.lower - ROUNDING <= truth.top <= bound.upper + ROUNDING


def audited(row: Audit, rng: np.random.Generator) -> Counts:
    """Run one campaign on premises that may be wrong and ask every audit of the method."""
    truth = Setting(rng, "list", 2, 2.5)
    norm, scale, delta = NORM / row.small_b, row.noise_scale / row.small_r, row.delta
    noise = scale / row.replicates**0.5
    told = method(truth, Premises(norm, noise, delta, mixture(norm, noise)), 0.02)
    each: list[list[float]] = []
    for _, index in zip(range(row.tests), places(told, rng, len(truth.values), 1), strict=False):
        each.append((truth.values[index] + rng.normal(0.0, row.noise_scale, row.replicates)).tolist())
        told.observe(*an_observation(index, float(np.mean(each[-1]))))
    bound, planned = told.bound(), row.tests * row.replicates
    by_norm = audit.norm_from_set(b_min=bound.b_min, rkhs_norm=norm, confidence=1.0 - delta)
    by_bounds = audit.bounds_agree(upper=bound.upper, lower=bound.lower)
    by_spread = audit.replicate_spread(each, noise_scale=scale, delta=delta, planned=planned)
    refuted = "refuted" in (by_norm.status, by_bounds.status)
    spread = by_spread is not None and by_spread.status == "refuted"
    wrong = wrong_bound(told, truth)
    return {
        "failed": (refuted or spread) and row.small_b == row.small_r == 1.0,
        "refuted": refuted,
        "spread": spread,
        "bound": wrong,
        "unnoticed": wrong and not (refuted or spread),
        "tests": told.bound().n,
    }

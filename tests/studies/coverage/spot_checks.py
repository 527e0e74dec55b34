"""Claims about every start that are false and unnoticed, with the spot check and without it.

Every function is a robustness on the box [0, 5]^2 whose truth is known on a grid of 40,401 points. A campaign of method
`rigorous` bounds it with a norm bound B that fits, or is too small; then the spot check tests the bound. A claim is
*silent* if it is false somewhere and nothing is refuted; `spot_page.py` counts them by the violated share of the box.

| symbol | name        | meaning                                                                      | shape  |
|--------|-------------|------------------------------------------------------------------------------|--------|
| f      | `values`    | robustness of a start, on the grid                                           | (N,)   |
| X      | `observed`  | what the method bounds: f, the clipped noisy one, or its linearised risk     |        |
| ell    |             | the claim: E[X] >= ell at every start                                        | ()     |
| h      | `share`     | share of the box where E[X] < ell; noisy: by one sd of a rollout or more     | ()     |
|        | `deficit`   | largest ell - E[X]                                                           | ()     |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from perfbound.schemas.platforms import one_blas_thread

one_blas_thread()

import numpy as np  # noqa: E402  (numpy reads the setting once)
from sklearn.gaussian_process import kernels as learned  # noqa: E402

from perfbound.orchestrator.mathematics.bounds.checks.spot_check import Hypothesis, SpotTests  # noqa: E402
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture  # noqa: E402
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod  # noqa: E402
from perfbound.orchestrator.mathematics.gp.kernels import Matern  # noqa: E402
from perfbound.orchestrator.mathematics.gp.lattice import Lattice  # noqa: E402
from tests.fakes.observations import an_observation  # noqa: E402
from tests.studies.coverage.functions import SIDE, Floats, Function, random_function  # noqa: E402

FUNCTIONS = 500
FACTORS = (1.0, 2.0, 4.0, 10.0)
"""By which B is too small."""
NU, LENGTH = 2.5, 1.5
LEVEL = 0.7
"""f is about this, and the prior mean as well."""
NORM = 0.5
"""Of the smooth part of every function."""
RESOLUTION = 7
ALPHA, DELTA = 0.1, 0.05
TESTS = {"exact": 16, "mean": 10, "risk": 10}
REPLICATES = 8
SD = 0.1
"""Of a rollout: the noise is -a, 0 or a with equal probability, with a = sqrt(3/2) sd, so that means are sums."""
CLIP = (-1.0, 1.5)
RISK_WEIGHT, SPREAD = 0.2, 0.12
STARTS = FOLLOWUPS = 299
LATTICE = Lattice((0.0, 0.0), (SIDE, SIDE), RESOLUTION)
LINES = 201
"""Points of the grid per axis."""
NOISE = SD * math.sqrt(1.5) * np.array([-1.0, 0.0, 1.0])


# Functions


def smooth(rng: np.random.Generator, norm: float) -> Function:
    """Return a function of exactly this norm."""
    return random_function(rng, 2, nu=NU, length_scale=LENGTH, norm=norm)


def kink(rng: np.random.Generator) -> Function:
    """Return the largest of several affine functions, with values in an interval of length NORM."""
    slopes = rng.normal(size=(int(rng.integers(2, 5)), 2))
    centres = rng.uniform(0.0, SIDE, slopes.shape)

    def raw(z: Floats) -> Floats:
        return np.asarray(np.max(z @ slopes.T - np.sum(slopes * centres, axis=1), axis=1))

    values = raw(grid(41))
    scale = NORM / float(np.ptp(values)) * float(rng.choice((-1.0, 1.0)))
    return lambda z: scale * (raw(z) - float(values.mean()))


def jump(rng: np.random.Generator) -> Function:
    """Return a smooth function that falls by a step beyond a straight line: .5 to 30 % of the box, often an edge."""
    angle = rng.choice((0.0, 0.5, 1.0, 1.5)) * math.pi if rng.random() < 0.5 else rng.uniform(0.0, 2.0 * math.pi)
    normal, base = np.array([math.cos(angle), math.sin(angle)]), smooth(rng, NORM / 2.0)
    share, depth = math.exp(rng.uniform(math.log(0.005), math.log(0.3))), rng.uniform(0.1, 1.4)
    limit = float(np.quantile(grid(LINES) @ normal, 1.0 - share))
    return lambda z: base(z) - depth * (z @ normal > limit)


def hole(rng: np.random.Generator) -> Function:
    """Return a smooth function with a narrow hole, a disc of .5 to 15 % of the box."""
    share, depth = math.exp(rng.uniform(math.log(0.005), math.log(0.15))), rng.uniform(0.1, 1.4)
    radius, base = SIDE * math.sqrt(share / math.pi), smooth(rng, NORM / 2.0)
    centre = rng.uniform(radius, SIDE - radius, 2)
    return lambda z: base(z) - depth * (np.sum(np.square(z - centre), axis=1) < radius**2)


def waves(rng: np.random.Generator) -> Function:
    """Return a product of waves that are mostly shorter than the distance between two nodes."""
    lengths, phases, height = rng.uniform(0.3, 2.0, 2), rng.uniform(0.0, 2.0 * math.pi, 2), rng.uniform(0.05, 0.4)
    return lambda z: height * np.prod(np.sin(2.0 * math.pi * z / lengths + phases), axis=1)


def flat(rng: np.random.Generator) -> Function:
    """Return a constant."""
    level = rng.uniform(-0.1, 0.1)
    return lambda z: np.full(len(z), level)


FAMILIES: dict[str, Callable[[np.random.Generator], Function]] = {
    "GP draws": partial(smooth, norm=NORM),
    "kinks": kink,
    "jumps": jump,
    "narrow holes": hole,
    "high frequency": waves,
    "flat": flat,
}


def grid(lines: int) -> Floats:
    """Return a grid over the box (lines^2, 2)."""
    axis = np.linspace(0.0, SIDE, lines)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def least_norm(values: Floats) -> float:
    """Return the least norm that explains these values on 11 x 11 points; no norm is enough for a jump."""
    points = grid(11)
    gram = learned.Matern(LENGTH, nu=NU)(points) + 1e-10 * np.eye(len(points))
    return max(math.sqrt(max(0.0, float(values @ np.linalg.solve(gram, values)))), 0.01)


@dataclass(frozen=True, slots=True)
class Truth:
    """A robustness without noise, and its values on three grids: 11 x 11 points, the lattice, LINES x LINES points."""

    function: Function
    coarse: Floats
    nodes: Floats
    fine: Floats


# What is bounded


@dataclass(frozen=True, slots=True)
class Observed:
    """A variable whose expectation a method bounds, as a function of the robustness of a rollout."""

    name: str
    low: float | None
    high: float | None

    @property
    def noisy(self) -> bool:
        """Whether a rollout is random."""
        return self.name != "exact"

    def of(self, robustness: Floats) -> Floats:
        """Return X of rollouts."""
        if self.name == "exact":
            return robustness
        clipped = np.clip(robustness, *CLIP)
        if self.name == "mean":
            return clipped
        return clipped - RISK_WEIGHT / 2.0 * (np.square(clipped - LEVEL) / SPREAD + SPREAD)

    def expectation(self, values: Floats) -> Floats:
        """Return E[X] where the robustness without noise is `values`."""
        return np.mean([self.of(values + each) for each in NOISE], axis=0) if self.noisy else self.of(values)

    def spread(self, values: Floats) -> Floats:
        """Return the standard deviation of X of a rollout where the robustness without noise is `values`."""
        return np.std([self.of(values + each) for each in NOISE], axis=0) if self.noisy else np.zeros_like(values)

    def rollouts(self, rng: np.random.Generator, value: float, count: int) -> Floats:
        """Return X of `count` rollouts at one start."""
        return self.of(value + rng.choice(NOISE, count)) if self.noisy else self.of(np.full(count, value))


def risk_range() -> tuple[float, float]:
    """Return the least and the largest X of a linearised risk: X is concave, so its ends and its top."""
    top = LEVEL + SPREAD / RISK_WEIGHT
    found = Observed("risk", None, None).of(np.array([*CLIP, min(max(top, CLIP[0]), CLIP[1])]))
    return float(found.min()), float(found.max())


OBSERVED = (Observed("exact", None, None), Observed("mean", *CLIP), Observed("risk", *risk_range()))


# Campaigns


@dataclass(frozen=True, slots=True)
class Found:
    """The end of one campaign."""

    family: str
    observed: str
    factor: float
    share: float
    """h, for noisy values of the deficits that count."""
    any_share: float
    """Share of the box where the claim is false at all."""
    deficit: float
    sd: float
    """Largest standard deviation of a rollout where the claim is false; 0 without noise."""
    refuted: bool
    """By the method."""
    contradicted: bool | None
    """By the spot check; None where it was not made, because the method refutes or a claim from a small B is true."""

    @property
    def judged(self) -> bool:
        """Whether the claim is false by enough to count."""
        return self.share > 0


def campaigns(number: int) -> list[Found]:
    """Return the campaigns of one function: every variable, every B."""
    family = list(FAMILIES)[number % len(FAMILIES)]
    rng = np.random.default_rng(np.random.SeedSequence(20261122, spawn_key=(number,)))
    draw = FAMILIES[family](rng)

    def function(z: Floats) -> Floats:
        return LEVEL + draw(z)

    truth = Truth(function, function(grid(11)), function(LATTICE.nodes), function(grid(LINES)))
    found = []
    for observed in OBSERVED:
        middle = float(observed.expectation(np.array([LEVEL]))[0])
        exact = (family, observed.name) == ("GP draws", "exact")
        norm = NORM if exact else least_norm(observed.expectation(truth.coarse) - middle)
        # A margin for the asymmetry that the clip and the risk add.
        noise = 1.1 * float(observed.spread(truth.fine).max())
        case = Case(family, truth, observed, middle, norm, noise)
        found += [campaign(rng, case, factor) for factor in FACTORS]
    return found


@dataclass(frozen=True, slots=True)
class Case:
    """One function, one variable, and the premises that fit them: the prior mean -`middle`, B and R of a rollout."""

    family: str
    truth: Truth
    observed: Observed
    middle: float
    norm: float
    noise: float


def campaign(rng: np.random.Generator, case: Case, factor: float) -> Found:
    """Run one campaign whose B is too small by a factor, and its spot check; the method maximises J = -X."""
    truth, observed, norm = case.truth, case.observed, case.norm / factor
    replicates = REPLICATES if observed.noisy else 1
    scale = case.noise / math.sqrt(replicates)
    premises = Premises(norm, scale, DELTA, mixture(norm, scale))
    method = RigorousMethod(LATTICE, Matern(NU, LENGTH), premises, alpha=ALPHA, prior_mean=-case.middle)
    first: int | None = int(rng.integers(LATTICE.size))
    while method.bound().status == "open" and method.bound().n < TESTS[observed.name]:
        node, first = method.propose(first).node, None
        seen = observed.rollouts(rng, float(truth.nodes[node]), replicates)
        method.observe(*an_observation(node, (-seen).tolist()))
    bound = method.bound()
    limit = bound.upper
    excess = -observed.expectation(truth.fine) - limit
    wrong = excess > 1e-9
    sd = observed.spread(truth.fine)
    counted = wrong & (excess >= sd)
    refuted = bound.status == "refuted"
    # Most of the time goes here. Claims that are true count with the right B alone, as false alarms.
    needed = not refuted and (bool(wrong.any()) or factor == 1.0)
    return Found(
        case.family,
        observed.name,
        factor,
        float(counted.mean()),
        float(wrong.mean()),
        float(excess.max()),
        float(sd[wrong].max()) if wrong.any() else 0.0,
        refuted,
        spot_checked(rng, truth.function, observed, limit) if needed else None,
    )


def spot_checked(rng: np.random.Generator, function: Function, observed: Observed, limit: float) -> bool:
    """Return whether the spot check refutes J <= limit."""
    starts = rng.uniform(0.0, SIDE, (STARTS, 2))
    values = function(starts)
    low, high = (None, None) if observed.low is None or observed.high is None else (-observed.high, -observed.low)
    tests = SpotTests(
        starts.tolist(),
        [Hypothesis("J", limit, low, high, noisy=observed.noisy)],
        followups=FOLLOWUPS if observed.noisy else 0,
    )
    while (chosen := tests.propose()) is not None:
        tests.observe(chosen.node, [-float(observed.rollouts(rng, float(values[chosen.node]), 1)[0])])
    return tests.finding(0).status == "refuted"

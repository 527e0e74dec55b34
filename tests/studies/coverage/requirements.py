"""Campaigns of several requirements that share each test: the claim about every requirement and each one's own.

In units of its scale, each requirement has the clip, the laws or the functions of its method's own rows. All bounds are
running extremes, so that one failed at some time if and only if it fails at the end.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np

from perfbound.orchestrator.mathematics.bounds.joint import JointMethod, SharedMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import ExhaustedError, RigorousMethod
from perfbound.orchestrator.mathematics.bounds.scenario import ScenarioMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import Bound, Observation, Proposal
from tests.studies.coverage.functions import Floats, random_function
from tests.studies.coverage.laws import CLIP, CONSTANTS, LAWS, RISK_WEIGHT, Law
from tests.studies.coverage.noises import NOISES
from tests.studies.coverage.oracle import ROUNDING
from tests.studies.coverage.regions import FLAT_LENGTH, FLAT_MIXTURE, FLAT_NORM
from tests.studies.coverage.rigorous import LENGTHS, candidates

REPLICATES = 5
NU, DIMENSION = 1.5, 2
BELOW = 2.0
"""Distance of the later flat requirements from the first one, in units of their scale."""

Split = Callable[[Observation], Sequence[Observation]]


@dataclass(frozen=True)
class Requirements:
    """One row: `law` is that of the robustness in `scenario`, that of the noise in `rigorous`.

    Requirement i has the scale `scale` to the power i. Their worst starts are `apart`, or the `same`; `flat` functions
    of `rigorous` are constant. With `shared` the rollouts of all requirements have the same randomness.
    """

    kind: ClassVar[str] = "requirements"
    method: str = "scenario"
    law: str = "two points"
    worst: str = "apart"
    scale: float = 1.0
    number: int = 2
    size: int = 4
    window: int = 1
    shared: bool = True
    noise_scale: float = 0.2
    tests: int = 30
    delta: float = 0.05

    @property
    def claimed(self) -> float:
        """The failure probability of each claim: none of them divides it."""
        return self.delta


def rows() -> Iterator[Requirements]:
    """Both methods; worst starts apart or the same, scales equal or different, two requirements or five."""
    for law in LAWS:
        yield Requirements("scenario", law, "same", scale=10.0, size=1)
        yield Requirements("scenario", law, "apart", scale=1.0, window=8, shared=False)
        yield Requirements("scenario", law, "same", scale=10.0)
    yield Requirements("scenario", "two points", "same", scale=10.0, size=1, delta=0.2)
    yield Requirements("scenario", "two points", "same", number=5, size=1)
    yield Requirements("scenario", "skewed", "apart", scale=0.1, number=5, window=8)
    for noise, scale in zip(NOISES, (10.0, 1.0, 0.1, 10.0), strict=True):
        yield Requirements("rigorous", noise, "flat", scale=scale, size=2, noise_scale=0.1, delta=0.5)
        yield Requirements("rigorous", noise, "apart", scale=scale, size=25, window=8, tests=20)
    yield Requirements("rigorous", "Gaussian", "flat", number=5, size=2, noise_scale=0.1)
    yield Requirements("rigorous", "Gaussian", "same", scale=10.0, size=25, noise_scale=1.0, tests=20, delta=0.5)
    yield Requirements("rigorous", "+-R", "same", scale=10.0, size=25, noise_scale=0.02, tests=20)


class Truth(Protocol):
    """The requirements of one campaign, their methods, and what is true of them."""

    @property
    def parts(self) -> Sequence[SharedMethod]:
        """The method of each requirement."""
        ...

    @property
    def least(self) -> Sequence[float]:
        """The largest value of -U that is right, of each requirement."""
        ...

    alphas: list[float]
    nodes: Floats

    def observed(self, index: int, rng: np.random.Generator) -> tuple[float, ...]:
        """Return the values of a test at a start, those of the first requirement first."""
        ...

    def is_false(self, place: int, bound: Bound) -> bool:
        """Return whether a requirement's own statement is false."""
        ...


def campaign(
    row: Requirements, rng: np.random.Generator, *, told: float | None = None, split: Split | None = None
) -> dict[str, float]:
    """Run one campaign, whose methods may get another delta, and return which claims were ever false.

    `split` gives each method its observation, in the order of the requirements if it is right.
    """
    truth: Truth = Listed(row, rng, told) if row.method == "scenario" else Smooth(row, rng, told)
    method = JointMethod(truth.parts, truth.alphas, split or (lambda found: in_order(found, row.number)), truth.nodes)
    bound, flying = Bound(None, None, None), list[Proposal]()
    tests = 0
    while tests < row.tests and bound.verdict is None:
        try:
            while len(flying) < row.window:
                first = None if tests or flying else int(rng.integers(method.size))
                flying.append(method.propose(first, [each.node for each in flying]))
        except ExhaustedError:
            break
        proposal = flying.pop(0)
        values = truth.observed(proposal.node, rng)
        bound = method.observe(proposal, Observation(0.0, values))
        tests += 1
    assert bound.upper is not None
    own = [truth.is_false(place, each) for place, each in enumerate(method.bounds)]
    return {
        "every": -bound.upper > min(truth.least) + ROUNDING,
        "first": own[0],
        "last": own[-1],
        "converged": bound.verdict == "converged",
        "tests": tests,
        "width": min(truth.least) + bound.upper,
    }


def in_order(observation: Observation, number: int) -> list[Observation]:
    """Return the observation of each requirement; its y is J of `rigorous`, and without use in `scenario`."""
    each = np.reshape(observation.each, (number, -1))
    return [Observation(float(own.mean()), tuple(own.tolist())) for own in each]


class Listed:
    """Starts without a kernel, each with a law of the robustness for each requirement."""

    def __init__(self, row: Requirements, rng: np.random.Generator, told: float | None) -> None:
        del rng  # nothing of the truth is random
        self._row, self._scales = row, [row.scale**place for place in range(row.number)]
        points = Points(tuple((float(k),) for k in range(row.size)))
        self.nodes, self.alphas = points.nodes, [0.15 * scale for scale in self._scales]
        (low, high), (centre, spread) = CLIP, CONSTANTS
        self.parts: list[SharedMethod] = [
            ScenarioMethod(
                points,
                clip=(scale * low, scale * high),
                risk_weight=RISK_WEIGHT,
                delta=told or row.delta,
                alpha=alpha,
                constants=(scale * centre, scale * spread),
            )
            for scale, alpha in zip(self._scales, self.alphas, strict=True)
        ]

    @cached_property
    def least(self) -> list[float]:
        """The least E[X] of each requirement, which its ell tends to."""
        return [
            scale * min(self._law(place, k).linearised for k in range(self._row.size))
            for place, scale in enumerate(self._scales)
        ]

    def observed(self, index: int, rng: np.random.Generator) -> tuple[float, ...]:
        """Return the replicates of every requirement."""
        seed = int(rng.integers(2**32))
        found: list[float] = []
        for place, scale in enumerate(self._scales):
            own = np.random.default_rng(seed if self._row.shared else seed + place)
            found += (scale * self._law(place, index).draw(own, REPLICATES)).tolist()
        return tuple(found)

    def is_false(self, place: int, bound: Bound) -> bool:
        """Return whether ell was above what it tends to."""
        assert bound.upper is not None
        return -bound.upper > self.least[place] + ROUNDING * self._scales[place]

    def _law(self, place: int, index: int) -> Law:
        worst, other = LAWS[self._row.law]
        return worst if index == (place % self._row.size if self._row.worst == "apart" else 0) else other


class Smooth:
    """Random points with a function of known norm for each requirement; the methods get the right premises."""

    def __init__(self, row: Requirements, rng: np.random.Generator, told: float | None) -> None:
        self._row, self._scales = row, [row.scale**place for place in range(row.number)]
        flat = row.worst == "flat"
        points = Points(((0.0,), (1.0,))) if flat else candidates(rng, "list", DIMENSION)
        norm = FLAT_NORM if flat else 1.0
        self.nodes, self.alphas = points.nodes, [0.1 * norm * scale for scale in self._scales]
        # A flat requirement after the first is below it, so that the first alone decides the claim about all.
        shifts = [-BELOW * scale if flat and place else 0.0 for place, scale in enumerate(self._scales)]
        self._values = [
            shift + scale * j for shift, scale, j in zip(shifts, self._scales, self._functions(rng), strict=True)
        ]
        self.least = [-float(values.max()) for values in self._values]
        self._past: list[list[float]] = [[] for _ in self._scales]
        kernel = Matern(NU, FLAT_LENGTH if flat else LENGTHS[DIMENSION])
        self.parts: list[SharedMethod] = [
            RigorousMethod(
                points,
                kernel,
                _premises(norm * scale, row.noise_scale * scale, told or row.delta, flat=flat),
                alpha=alpha,
                prior_mean=shift,
            )
            for scale, alpha, shift in zip(self._scales, self.alphas, shifts, strict=True)
        ]

    def observed(self, index: int, rng: np.random.Generator) -> tuple[float, ...]:
        """Return one noisy value of J of every requirement."""
        seed = int(rng.integers(2**32))
        for place, (scale, past) in enumerate(zip(self._scales, self._past, strict=True)):
            own = np.random.default_rng(seed if self._row.shared else seed + place)
            past.append(NOISES[self._row.law](own, self._row.noise_scale * scale, index, past))
        return tuple(float(j[index]) + past[-1] for j, past in zip(self._values, self._past, strict=True))

    def is_false(self, place: int, bound: Bound) -> bool:
        """Return whether U or L was on the wrong side of max J, or the true premises were refuted."""
        assert bound.upper is not None
        assert bound.lower is not None
        top, rounding = -self.least[place], ROUNDING * self._scales[place]
        return bound.verdict == "refuted" or not bound.lower - rounding <= top <= bound.upper + rounding

    def _functions(self, rng: np.random.Generator) -> list[Floats]:
        row = self._row
        if row.worst == "flat":
            return [np.zeros(len(self.nodes)) for _ in self._scales]
        length = LENGTHS[DIMENSION]
        draws = [
            random_function(rng, DIMENSION, nu=NU, length_scale=length, norm=1.0)(self.nodes) for _ in self._scales
        ]
        return draws if row.worst == "apart" else [draws[0]] * row.number


def _premises(norm: float, noise: float, delta: float, *, flat: bool) -> Premises:
    return Premises(norm, noise, delta, FLAT_MIXTURE if flat else mixture(norm, noise))

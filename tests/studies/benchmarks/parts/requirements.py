"""Tests that three requirements take together, beside the one that takes most alone, on functions of two parameters.

The methods are those of a campaign; the functions are computed here, with noise of their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.bounds.joint import JointMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.values import Observation
from tests.studies.benchmarks.report import Row

SEEDS = range(5)
MOST = 400
LIMIT = 1.15

Floats = NDArray[np.float64]
Function = Callable[[Floats, np.random.Generator], Sequence[float]]
"""(start (2,), noise) -> the observation of J of each requirement."""


@dataclass(frozen=True)
class Constants:
    """Those of one requirement, noise per test."""

    alpha: float
    rkhs_norm: float
    prior_mean: float
    noise_scale: float


@dataclass(frozen=True)
class Case:
    """Three requirements of one system."""

    name: str
    box: Lattice
    lengths: tuple[float, float]
    constants: tuple[Constants, ...]
    function: Function


def cars(start: Floats, rng: np.random.Generator, replicates: int = 8, reaction: float = 0.6) -> Sequence[float]:
    """Return distance kept, stop in time and contact kept of the cars that ship, each the mean of 8 rollouts."""
    gap, speed = start
    t = np.arange(0.0, 8.025, 0.05)
    values = []
    for delay in reaction * rng.uniform(0.8, 1.2, replicates):
        ahead = np.maximum(speed - 6 * t, 0)
        follower = np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
        distance = gap + 0.05 * np.cumsum(ahead - follower)
        values.append((distance.min() - 2, 8 - follower[t < 4.01].min(), 60 - distance.max()))
    return [-float(value) for value in np.mean(values, axis=0)]


def near(start: Floats, rng: np.random.Generator) -> Sequence[float]:
    """Return three hills whose tops are near one another, without noise."""
    del rng
    tops, widths, heights = ((0.2, 0.3), (0.35, 0.2), (0.25, 0.5)), (0.3, 0.4, 0.5), (1.0, 0.8, 0.6)
    return [
        height * float(np.exp(-((start - top) ** 2).sum() / width))
        for top, width, height in zip(tops, widths, heights, strict=True)
    ]


def apart(start: Floats, rng: np.random.Generator) -> Sequence[float]:
    """Return three hills in three corners, without noise."""
    del rng
    tops = ((0.0, 0.0), (1.0, 0.1), (0.1, 1.0))
    return [float(np.exp(-((start - np.array(top)) ** 2).sum() / 0.4)) for top in tops]


SQUARE = Lattice((0.0, 0.0), (1.0, 1.0), 21)
HILLS = (Constants(0.05, 3.0, 0.0, 0.0),) * 3
CASES = (
    Case(
        "cars",
        Lattice((20.0, 10.0), (50.0, 30.0), 21),
        (30.0, 20.0),
        (Constants(3, 40, -25, 2.1 / 8**0.5), Constants(1, 20, -7, 0.7 / 8**0.5), Constants(3, 40, -25, 0.5 / 8**0.5)),
        cars,
    ),
    Case("worst starts near one another", SQUARE, (0.5, 0.5), HILLS, near),
    Case("worst starts in three corners", SQUARE, (0.5, 0.5), HILLS, apart),
)


def method(case: Case, places: Sequence[int]) -> JointMethod[RigorousMethod]:
    """Return the methods of some of the requirements."""
    parts = []
    for each in (case.constants[place] for place in places):
        premises = Premises(
            rkhs_norm=each.rkhs_norm,
            noise_scale=each.noise_scale,
            delta=0.05,
            regularisers=mixture(each.rkhs_norm, each.noise_scale) if each.noise_scale else (),
            tau=0.0,
            round_off=1e-9,
        )
        parts.append(
            RigorousMethod(case.box, Matern(2.5, case.lengths), premises, alpha=each.alpha, prior_mean=each.prior_mean)
        )
    alphas = [case.constants[place].alpha for place in places]
    return JointMethod(parts, alphas, _split, case.box.nodes)


def _split(observation: Observation) -> list[Observation]:
    return [Observation(value, (value,)) for value in observation.each]


def tests(case: Case, places: Sequence[int], seed: int) -> int:
    """Return the tests until the requirements have all converged, at most `MOST`."""
    rng, found, count = np.random.default_rng(seed), method(case, places), 0
    first = int(rng.integers(case.box.size))
    while count < MOST:
        proposal = found.propose(None if count else first)
        values = case.function(np.array(proposal.x), rng)
        chosen = tuple(values[place] for place in places)
        count += 1
        if found.observe(proposal, Observation(max(chosen), chosen)).verdict is not None:
            break
    return count


def main() -> list[Row]:
    """Return a row for each case: three together, beside the hardest alone."""
    rows = []
    for case in CASES:
        count = partial(_median, case)
        hardest = max(count((place,)) for place in range(3))
        rows.append(
            Row(
                f"requirements, {case.name}: three together",
                count((0, 1, 2)),
                "tests",
                "the hardest alone",
                hardest,
                ratio_at_least=1 / LIMIT,
            )
        )
    return rows


def _median(case: Case, places: Sequence[int]) -> float:
    return float(np.median([tests(case, places, seed) for seed in SEEDS]))

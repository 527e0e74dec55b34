"""Rollouts in [0, 1] with a given mean in [.6, .9], in kinds. Nothing here knows the orchestrator.

A kind is a function (rng, mean, sum of the errors of all rollouts before) -> the next `count` rollouts, (count,).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Law = Callable[[np.random.Generator, float, float, int], Floats]

WIDTH = 0.1
"""Half the width of the law `uniform`; its standard deviation is .058."""
NARROW = 0.005
LEAD = 0.5
"""Sum of the errors from which on the law `adaptive` hardly varies."""


def two_points(rng: np.random.Generator, mean: float, _errors: float, count: int) -> Floats:
    """0 or 1: the largest variance of all laws with this mean."""
    return (rng.random(count) < mean).astype(np.float64)


def skewed(rng: np.random.Generator, mean: float, _errors: float, count: int) -> Floats:
    """Rarely (15 %) a fall by two thirds, otherwise .1 above the mean."""
    return np.asarray(mean + 0.1 - (rng.random(count) < 0.15) / 1.5, dtype=np.float64)


def by_start(rng: np.random.Generator, mean: float, _errors: float, count: int) -> Floats:
    """Uniform, and wider where the mean is lower: nearly exact at .9, from .3 to .9 at .6."""
    return mean + (0.905 - mean) * rng.uniform(-1.0, 1.0, count)


def adaptive(rng: np.random.Generator, mean: float, errors: float, count: int) -> Floats:
    """0 or 1 until the errors have added up to a lead, and nearly exact as long as the lead lasts."""
    return exact(rng, mean, errors, count) if errors > LEAD else two_points(rng, mean, errors, count)


def uniform(rng: np.random.Generator, mean: float, _errors: float, count: int) -> Floats:
    """Uniform around the mean."""
    return mean + WIDTH * rng.uniform(-1.0, 1.0, count)


def exact(rng: np.random.Generator, mean: float, _errors: float, count: int) -> Floats:
    """Nearly without noise."""
    return mean + NARROW * rng.uniform(-1.0, 1.0, count)


BOUNDED: dict[str, Law] = {
    "two points": two_points,
    "skewed": skewed,
    "by start": by_start,
    "adaptive": adaptive,
    "uniform": uniform,
    "nearly exact": exact,
}

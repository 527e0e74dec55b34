"""Noise that is R-sub-Gaussian given the past, in kinds. Nothing here knows the orchestrator.

A kind is a function (rng, R, index of the test's place, noise of the tests before) -> noise of this test.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

Noise = Callable[[np.random.Generator, float, int, Sequence[float]], float]


def gaussian(rng: np.random.Generator, scale: float, _index: int, _past: Sequence[float]) -> float:
    """Normal with standard deviation R."""
    return float(rng.normal(0.0, scale))


def two_point(rng: np.random.Generator, scale: float, _index: int, _past: Sequence[float]) -> float:
    """+R or -R: the largest variance that the scale allows."""
    return float(rng.choice((-scale, scale)))


def skewed(rng: np.random.Generator, scale: float, _index: int, _past: Sequence[float]) -> float:
    """Centred, rarely large, within an interval of length 2R: R-sub-Gaussian by Hoeffding's lemma."""
    return 2.0 * scale * (0.9 if rng.random() < 0.1 else -0.1)


def adaptive(rng: np.random.Generator, scale: float, index: int, past: Sequence[float]) -> float:
    """Normal; its standard deviation depends on the place and falls silent as soon as the past errors have added up."""
    if math.fsum(past) > scale * math.sqrt(len(past) + 1.0):
        return float(rng.normal(0.0, scale / 20.0))
    return float(rng.normal(0.0, scale if index % 2 else scale / 3.0))


NOISES: dict[str, Noise] = {"Gaussian": gaussian, "+-R": two_point, "skewed": skewed, "adaptive": adaptive}

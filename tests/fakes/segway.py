"""Disturbances of the Segway that a test gives it."""

import math

import numpy as np

from perfbound.workers.systems.segway.system import DISTURBANCES

NAMES = tuple(each.name for each in DISTURBANCES)
STILL = dict.fromkeys(NAMES, 0.0)
"""No error of the start: what the variant nominal has."""


def errors(seed: int, variance: float = 0.05) -> dict[str, float]:
    """Return independent normal errors of the start, with this variance (m^2 and rad^2), from a seed."""
    drawn = np.random.default_rng(seed).normal(0.0, math.sqrt(variance), len(NAMES))
    return dict(zip(NAMES, drawn.tolist(), strict=True))

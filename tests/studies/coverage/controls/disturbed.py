"""Rollouts that follow from disturbances, or pretend to, with exact moments. Nothing here knows the orchestrator.

| symbol | name     | meaning                                                                        | shape  | unit |
|--------|----------|--------------------------------------------------------------------------------|--------|------|
| t, w   | `scores` | a standard normal number, and 0 with probability RARE, else 1                  | (b, 2) | -    |
| X      |          | rollout, in [0, 1], of mean MEAN                                               | (b,)   | -    |
| a      | `side`   | 1 or -1, as an adversary chooses it from the past                              | ()     | -    |
| s      | `scale`  | standard deviation of t, which is declared as 1                                | ()     | -    |
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

MEAN, RARE, RISK_WEIGHT = 0.6, 0.15, 0.2
CELLS = 200_000

Floats = NDArray[np.float64]
Value = Callable[[Floats, np.random.Generator, int], Floats]
"""From scores (b, 2), for what does not follow from them, and the side that the adversary takes."""


class Disturbed(NamedTuple):
    """Rollouts as a function of scores, and values of a distribution with equal probabilities for their moments."""

    value: Value
    law: Floats

    def risk(self) -> float:
        """Return E X - r sd(X)."""
        return MEAN - RISK_WEIGHT * float(self.law.std())

    def worst_half(self) -> float:
        """Return the mean of the worst half, CVaR_(1/2)."""
        return float(np.sort(self.law)[: len(self.law) // 2].mean())


def draw(rng: np.random.Generator, count: int, scale: float = 1.0) -> Floats:
    """Return scores (b, 2)."""
    return np.column_stack([scale * rng.standard_normal(count), rng.random(count) >= RARE])


def _curve(t: Floats) -> Floats:
    return np.asarray(0.2 * np.tanh(t))


def _cauchy(t: Floats) -> Floats:
    """0.04 times a Cauchy number, cut at 0.35."""
    return np.asarray(np.clip(0.04 * np.tan(np.pi * (ndtr(t) - 0.5)), -0.35, 0.35))


def _clipped(t: Floats, scale: float = 1.0) -> Floats:
    """A fall by 0.25 of -t, by at most 0.4, less its mean where t has standard deviation s."""
    slope, end = 0.25 * scale, 0.4 / (0.25 * scale)
    density = [math.exp(-each * each / 2) / math.sqrt(2 * math.pi) for each in (0.0, end)]
    mean = slope * (density[0] - density[1]) + 0.4 * float(ndtr(-end))
    return np.asarray(mean - np.clip(-0.25 * t, 0.0, 0.4))


T: Floats = ndtri((np.arange(CELLS) + 0.5) / CELLS)
TWO: Floats = np.repeat([0.0, 1.0], [4, 6])
FALL: Floats = np.repeat([0.1 - 1 / 1.5, 0.1], [3, 17])

DISTURBED: dict[str, Disturbed] = {
    "explain everything": Disturbed(lambda scores, _, __: MEAN + _curve(scores[:, 0]), MEAN + _curve(T)),
    "explain nothing": Disturbed(lambda scores, rng, _: (rng.random(len(scores)) < MEAN).astype(np.float64), TWO),
    "against the control": Disturbed(lambda scores, _, side: MEAN + side * _curve(scores[:, 0]), MEAN + _curve(T)),
    "heavy tails": Disturbed(lambda scores, _, __: MEAN + _cauchy(scores[:, 0]), MEAN + _cauchy(T)),
    "clipped": Disturbed(lambda scores, _, __: MEAN + _clipped(scores[:, 0]), MEAN + _clipped(T)),
    "two values": Disturbed(lambda scores, _, __: MEAN + 0.1 - (scores[:, 1] == 0.0) / 1.5, MEAN + FALL),
}
"""By what the disturbances do. An adversary turns the curve of t against the slope that the control has learnt."""


def of_scale(scale: float) -> Disturbed:
    """Rollouts of mean MEAN, a fall that t of this standard deviation explains: declared as 1, it biases a control."""
    return Disturbed(lambda scores, _, __: MEAN + _clipped(scores[:, 0], scale), MEAN + _clipped(scale * T, scale))

"""Mean and standard deviation of the rollouts at many starts, most of which have few."""

import math

import numpy as np

from ...gp.kernels import Floats

BORROWED = 3.0
"""Degrees of freedom that a start without enough rollouts of its own takes from all starts."""


class Spread:
    """Mean excess of every start, and a standard deviation of one rollout that small samples share.

    The variance within starts is pooled; while it has few degrees of freedom, the variance between first rollouts
    counts as BORROWED of them, and a quarter of the range as the first of those. A start's own variance enters by its
    degrees of freedom. It serves bets and choices, which may be any function of the past: no claim depends on it.
    """

    def __init__(self, size: int, width: float) -> None:
        self.count = np.zeros(size)  # (m,)
        self.mean = np.zeros(size)  # (m,) unit J
        self._squares = np.zeros(size)  # (m,) squared deviations from the mean of the start
        self._within = self._degrees = 0.0  # sums over the starts
        self._started = self._centre = 0.0  # number and mean of the first rollouts
        self._between = (width / 4.0) ** 2 if math.isfinite(width) else 1.0
        self._least = 1e-6 * width if math.isfinite(width) else 1e-6

    def add(self, node: int, excess: float) -> None:
        """Add the excess of one rollout [Welford's update]."""
        if self.count[node]:
            self._degrees += 1.0
        else:
            self._started += 1.0
            shift = excess - self._centre
            self._centre += shift / self._started
            self._between += shift * (excess - self._centre)
        self.count[node] += 1.0
        shift = excess - self.mean[node]
        self.mean[node] += shift / self.count[node]
        square = shift * (excess - self.mean[node])
        self._squares[node] += square
        self._within += square

    def sd(self) -> Floats:
        """Return the estimated standard deviation of one rollout at every start (m,), positive."""
        between = self._between / (self._started + 1.0)
        common = (self._within + BORROWED * between) / (self._degrees + BORROWED)
        own = (self._squares + BORROWED * common) / (np.maximum(self.count - 1.0, 0.0) + BORROWED)
        return np.maximum(np.sqrt(own), self._least)

"""What a search knows: a Gaussian process of each part of its goal, and one of the whole, and what they propose.

| function                                  | arm      | purpose                                           |
|-------------------------------------------|----------|---------------------------------------------------|
| ln P(z < t), of the parts together        | `LIKELY` | far from 0 it explores, near 0 it goes there      |
| the same, of the whole                    | `WHOLE`  | where parts that cannot fail lead nowhere         |
| E max(min z - Z, 0), Z ~ N(mu, sigma^2)   | `LOWER`  | leads downwards where a jump hides the way to 0   |
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from ..gp.kernels import Floats
from .goal import Goal, log_failure, numbers
from .portfolio import Arm
from .surrogate import Surrogate, fitted, prior_mode
from .warp import warped

LARGEST = 200
"""Tests that a model contains; of more, the worst half and an even choice of the others."""
LARGEST_FITTED = 80
"""Tests that the length scales are fitted to, chosen alike."""
FEWEST = 2
"""Tests after which a value that most of them share, and none is below, leads nowhere: without a mean a model goes from
corner to corner."""
GROWTH = 0.1
"""The length scales are fitted again after so many more tests, relative to their number."""

Score = Callable[[Floats], Floats]
"""Points (m, p) of the unit box -> values (m,) of an acquisition function."""


class Models:
    """The models of a goal; fed with points of the unit box and the robustness of each part."""

    def __init__(self, dimension: int, goal: Goal) -> None:
        self._goal, self.parts = goal, (parts := 1 + max(numbers(goal)))
        # The last is that of the whole; where there is one part, it is the whole.
        self._thetas = [prior_mode(dimension)] * (parts if parts == 1 else parts + 1)
        self._next_fit = 3
        self.points: list[Floats] = []
        self._values: list[tuple[float, ...]] = []
        self.robustness: list[float] = []
        """Of the whole formula."""

    def observe(self, point: Floats, values: Sequence[float], robustness: float) -> None:
        """Take a test."""
        self.points.append(point)
        self._values.append(tuple(values))
        self.robustness.append(robustness)
        # At numbers of observations alone, so that tests in flight change no length scale.
        if len(self.points) >= self._next_fit:
            points = np.array(self.points)
            for number, values_of in enumerate(self._modelled()):
                kept, z, _ = _chosen(values_of, LARGEST_FITTED)
                if np.ptp(z) > 0:
                    self._thetas[number] = fitted(points[kept], z, self._thetas[number])
            self._next_fit = len(self.points) + max(1, int(GROWTH * len(self.points)))

    @property
    def flat(self) -> bool:
        """Whether nothing has been seen that could lead anywhere: most tests share the least value of each part."""
        if len(self.points) < FEWEST:
            return False
        return all(2 * part.count(min(part)) > len(part) for part in zip(*self._values, strict=True))

    def scores(self, arm: Arm, pending: Sequence[Floats]) -> tuple[Score, Floats]:
        """Return the acquisition function of an arm and the length scales (p,) around its best points."""
        modelled = list(zip(self._modelled(), self._thetas, strict=True))
        if arm is not Arm.LIKELY:
            model, z, level = self._fitted(*modelled[-1], pending)
            if arm is Arm.WHOLE:
                return (lambda found: _deviations(model, found, level)), model.lengths
            return (lambda found: _improvement(model, found, float(np.min(z)))), model.lengths
        models = [self._fitted(*each, pending) for each in modelled[: self.parts]]
        lengths = np.min([model.lengths for model, _, _ in models], axis=0)

        def score(found: Floats) -> Floats:
            deviations = [_deviations(model, found, level) for model, _, level in models]
            # Of one part they order alike, and tell starts apart whose probabilities are both 1 to the last digit.
            return deviations[0] if self.parts == 1 else log_failure(self._goal, scipy.special.log_ndtr(deviations))

        return score, lengths

    def _fitted(self, values: Floats, theta: Floats, pending: Sequence[Floats]) -> tuple[Surrogate, Floats, float]:
        """Return the model of some values (n,), these on its scale, and the level of 0 there."""
        kept, z, level = _chosen(values, LARGEST)
        # Beyond so many tests in flight, only the latest are kept apart: a bound on the cost.
        return Surrogate(theta, np.array(self.points)[kept], z, pending[-LARGEST:]), z, level

    def _modelled(self) -> list[Floats]:
        """Return the values (n,) of each model: of each part, and of the whole."""
        values = np.array(self._values, dtype=np.float64)
        each = list(values.T)
        return each if self.parts == 1 else [*each, np.array(self.robustness)]


def _chosen(values: Floats, largest: int) -> tuple[NDArray[np.intp], Floats, float]:
    """Return which of the values are kept, at most `largest`, their warped values and the level of 0 on that scale."""
    z, level = warped(values)
    if len(z) <= largest:
        return np.arange(len(z)), z, level
    order = np.argsort(z, kind="stable")
    worst, others = order[: largest // 2], np.sort(order[largest // 2 :])
    spread = np.linspace(0, len(others) - 1, largest - len(worst)).astype(np.intp)
    kept = np.sort(np.concatenate([worst, others[spread]]))
    return kept, z[kept], level


def _deviations(model: Surrogate, points: Floats, level: float) -> Floats:
    """Return how many standard deviations the level is above the mean, (m,): P(z < t) grows with it."""
    mean, sd = model.moments(points)
    return (level - mean) / sd


def _improvement(model: Surrogate, points: Floats, level: float) -> Floats:
    """Return the logarithm of the expected improvement below the level, shape (m,).

    Formula: with u = (level - mu)/sigma, ln sigma + ln(u Phi(u) + phi(u)); far below, phi(u)/u^2 (Mills' ratio).
    """
    mean, sd = model.moments(points)
    u = (level - mean) / sd
    density = -0.5 * u * u - 0.5 * math.log(2 * math.pi)  # ln phi(u)
    # ln(1 + u Phi(u)/phi(u)); its argument loses its digits where Phi is small.
    ratio = u * np.exp(np.minimum(scipy.special.log_ndtr(u) - density, 700.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.where(u > -25.0, np.log1p(np.maximum(ratio, -1.0)), -2.0 * np.log(np.abs(u)))
    return np.asarray(np.log(sd) + density + inner, dtype=np.float64)

"""Hat functions of the score of one disturbance, with their exact means.

| symbol | name     | meaning                                                                  | shape | unit |
|--------|----------|--------------------------------------------------------------------------|-------|------|
| t      | `scores` | score of a disturbance: the normal quantile of its uniform number, or of | (n,)  | -    |
|        |          | finitely many values the number of the one that was drawn                |       |      |
| c_j    | `knots`  | increasing                                                               | (m,)  | -    |
| H_j    |          | 1 at c_j, 0 at the others, linear in between, constant outside           |       | -    |
| p_j    | `means`  | E H_j(t) under the law of t; they sum up to 1                            | (m,)  | -    |
| q_ij   | `pairs`  | E H_i(t) H_j(t)                                                          | (m,m) | -    |

A score has one of two known laws whatever law was declared, so that the means are exact for every law.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..gp.kernels import Floats

REACH = 3.0
"""Of the knots of a normal score: beyond it are 27 of 10,000 scores, where the functions are constant."""
MOST_KNOTS = 13


@dataclass(frozen=True)
class Basis:
    """The hat functions of one disturbance."""

    knots: Floats
    means: Floats
    pairs: Floats

    def variance(self, levels: Floats) -> float:
        """Return the variance of the function with these values at the knots (m,), under the law of the score.

        >>> round(normal_basis(3).variance(np.array([-3.0, 0.0, 3.0])), 3)
        0.995

        """
        mean = float(levels @ self.means)
        return max(float(levels @ self.pairs @ levels) - mean * mean, 0.0)

    def hats(self, scores: Floats) -> Floats:
        """Return H_j(t) of scores (n,), shape (n, m)."""
        return _hats(self.knots, scores)


@cache
def normal_basis(knots: int = MOST_KNOTS) -> Basis:
    """Return the functions of a normal score with so many knots, at least 2.

    >>> basis = normal_basis(3)
    >>> basis.knots.tolist(), round(float(basis.means.sum()), 15), bool(basis.means[0] == basis.means[2])
    ([-3.0, 0.0, 3.0], 1.0, True)

    """
    places = np.linspace(-REACH, REACH, knots)
    # Between a and b: P(a < t < b) = Phi(b) - Phi(a), E[t; a < t < b] = phi(a) - phi(b), and
    # E[t^2; a < t < b] = Phi(b) - Phi(a) + a phi(a) - b phi(b).
    density = [math.exp(-0.5 * each * each) / math.sqrt(2.0 * math.pi) for each in places.tolist()]
    below = [0.5 * math.erfc(-each / math.sqrt(2.0)) for each in places.tolist()]
    means, pairs = np.zeros(knots), np.zeros((knots, knots))
    means[0], means[-1] = pairs[0, 0], pairs[-1, -1] = below[0], 1.0 - below[-1]
    for j in range(knots - 1):
        width, inside = places[j + 1] - places[j], below[j + 1] - below[j]
        rising = (density[j] - density[j + 1] - places[j] * inside) / width
        means[j] += inside - rising
        means[j + 1] += rising
        squared = inside + places[j] * density[j] - places[j + 1] * density[j + 1]
        first = density[j] - density[j + 1]
        square = (squared - 2.0 * places[j] * first + places[j] ** 2 * inside) / width**2
        pairs[j, j] += inside - 2.0 * rising + square
        pairs[j, j + 1] = pairs[j + 1, j] = rising - square
        pairs[j + 1, j + 1] += square
    # By symmetry; the formula loses a last digit.
    return Basis(places, 0.5 * (means + means[::-1]), pairs)


def choice_basis(probabilities: Sequence[float], most: int = MOST_KNOTS) -> Basis:
    """Return the functions of the number of a value, 0, 1, ..., with these probabilities, at most `most` of them.

    Of more values the functions are linear in their number between equally spaced ones.

    >>> choice_basis([0.2, 0.5, 0.3]).means.tolist()
    [0.2, 0.5, 0.3]

    """
    count = len(probabilities)
    knots = np.unique(np.rint(np.linspace(0.0, count - 1.0, min(count, most))))
    hats = _hats(knots, np.arange(float(count)))
    means = np.array([math.fsum((np.array(probabilities) * column).tolist()) for column in hats.T])
    return Basis(knots, means, hats.T @ (np.array(probabilities)[:, np.newaxis] * hats))


def _hats(knots: Floats, scores: Floats) -> Floats:
    m = len(knots)
    if m == 1:
        return np.ones((len(scores), 1))
    place = np.clip(np.searchsorted(knots, scores, side="right") - 1, 0, m - 2)
    left, right = knots[place], knots[place + 1]
    share = np.clip((scores - left) / (right - left), 0.0, 1.0)
    found = np.zeros((len(scores), m))
    rows = np.arange(len(scores))
    found[rows, place], found[rows, place + 1] = 1.0 - share, share
    return found

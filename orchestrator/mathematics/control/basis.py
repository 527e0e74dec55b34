"""Hat functions of the score of one disturbance, with their exact means.

| symbol | name     | meaning                                                                  | shape | unit |
|--------|----------|--------------------------------------------------------------------------|-------|------|
| t      | `scores` | score of a disturbance: the normal quantile of its uniform number, or of | (n,)  | -    |
|        |          | finitely many values the number of the one that was drawn                |       |      |
| c_j    | `knots`  | increasing                                                               | (m,)  | -    |
| H_j    |          | 1 at c_j, 0 at the others, linear in between, constant outside           |       | -    |
| p_j    | `means`  | E H_j(t) under the law of t; they sum up to 1                            | (m,)  | -    |

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

    def hats(self, scores: Floats) -> Floats:
        """Return H_j(t) of scores (n,), shape (n, m)."""
        m = len(self.knots)
        if m == 1:
            return np.ones((len(scores), 1))
        place = np.clip(np.searchsorted(self.knots, scores, side="right") - 1, 0, m - 2)
        left, right = self.knots[place], self.knots[place + 1]
        share = np.clip((scores - left) / (right - left), 0.0, 1.0)
        found = np.zeros((len(scores), m))
        rows = np.arange(len(scores))
        found[rows, place], found[rows, place + 1] = 1.0 - share, share
        return found


@cache
def normal_basis(knots: int = MOST_KNOTS) -> Basis:
    """Return the functions of a normal score with so many knots, at least 2.

    >>> basis = normal_basis(3)
    >>> basis.knots.tolist(), round(float(basis.means.sum()), 15), bool(basis.means[0] == basis.means[2])
    ([-3.0, 0.0, 3.0], 1.0, True)

    """
    places = np.linspace(-REACH, REACH, knots)
    # Between a and b: E[t; a < t < b] = phi(a) - phi(b), P(a < t < b) = Phi(b) - Phi(a).
    density = [math.exp(-0.5 * each * each) / math.sqrt(2.0 * math.pi) for each in places.tolist()]
    below = [0.5 * math.erfc(-each / math.sqrt(2.0)) for each in places.tolist()]
    means = np.zeros(knots)
    means[0], means[-1] = below[0], 1.0 - below[-1]
    for j in range(knots - 1):
        width, inside = places[j + 1] - places[j], below[j + 1] - below[j]
        rising = (density[j] - density[j + 1] - places[j] * inside) / width
        means[j] += inside - rising
        means[j + 1] += rising
    # By symmetry; the formula loses a last digit.
    return Basis(places, 0.5 * (means + means[::-1]))


def choice_basis(probabilities: Sequence[float], most: int = MOST_KNOTS) -> Basis:
    """Return the functions of the number of a value, 0, 1, ..., with these probabilities, at most `most` of them.

    Of more values the functions are linear in their number between equally spaced ones.

    >>> choice_basis([0.2, 0.5, 0.3]).means.tolist()
    [0.2, 0.5, 0.3]

    """
    count = len(probabilities)
    knots = np.unique(np.rint(np.linspace(0.0, count - 1.0, min(count, most))))
    hats = Basis(knots, np.zeros(len(knots))).hats(np.arange(float(count)))
    return Basis(knots, np.array([math.fsum((np.array(probabilities) * column).tolist()) for column in hats.T]))

"""The fit of a control: penalised least squares on rollouts of one start each, the same on every machine.

| symbol | name      | meaning                                                                   | shape   | unit   |
|--------|-----------|---------------------------------------------------------------------------|---------|--------|
| x      |           | value of a rollout, less the mean of the rollouts of its start            | (n,)    | unit X |
| A      | `rows`    | the functions of the disturbances, less their means over the same rollouts | (n, K) | -      |
| beta   |           | minimises |x - A beta|^2 + lambda beta' P beta + a small multiple of |beta|^2 | (K,) | unit X |
| P      | `penalty` | squared second differences along the knots of each disturbance            | (K, K)  | -      |
| lambda |           | chosen by its error on the second half after a fit on the first           | ()      | -      |

Nothing of a fit decides whether a bound holds, only how tight it is. But every machine has to find the same: A and x
are rounded to whole numbers, whose products BLAS sums without any error, and what follows is one operation after the
other, in an order that no library chooses.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats

UNIT = 2.0**15
"""A function, at most 1 in size, is a whole number of its inverse."""
UNIT_OF_X = 2.0**20
"""Of the range of x."""
MOST_ROLLOUTS = 2**13
"""With which all sums stay below 2^53; more would fit no better."""
PENALTIES = (0.03, 0.3, 3.0, 30.0)
RIDGE = 1e-3
TINY = 1e-9


@dataclass(frozen=True)
class OfStart:
    """Sums of the functions (K,) and of x over the rollouts of one start, and their number."""

    rows: Floats
    x: float
    count: int


@dataclass(frozen=True)
class Sums:
    """Sums over rollouts in whole numbers: A'A, A'x and x'x before any mean is subtracted, and those of each start."""

    gram: Floats
    moment: Floats
    square: float
    starts: Mapping[int, OfStart]

    @classmethod
    def empty(cls, width: int) -> "Sums":
        """Return those of no rollout."""
        return cls(np.zeros((width, width)), np.zeros(width), 0.0, {})

    @property
    def count(self) -> int:
        """Number of rollouts."""
        return sum(each.count for each in self.starts.values())

    def plus(self, start: int, rows: Floats, x: Floats) -> "Sums":
        """Return the sums with further rollouts of one start: functions (n, K), and x (n,) in units of its range."""
        whole, values = np.rint(rows * UNIT), np.rint(x * UNIT_OF_X)
        before = self.starts.get(start, OfStart(np.zeros(rows.shape[1]), 0.0, 0))
        added = OfStart(before.rows + whole.sum(axis=0), before.x + float(values.sum()), before.count + len(x))
        gram, moment = self.gram + whole.T @ whole, self.moment + whole.T @ values
        return Sums(gram, moment, self.square + float(values @ values), {**self.starts, start: added})

    def minus(self, other: "Sums") -> "Sums":
        """Return the sums without those of some of the rollouts."""
        none = OfStart(np.zeros_like(self.moment), 0.0, 0)
        pairs = {start: (each, other.starts.get(start, none)) for start, each in self.starts.items()}
        starts = {
            start: OfStart(each.rows - less.rows, each.x - less.x, each.count - less.count)
            for start, (each, less) in pairs.items()
            if each.count > less.count
        }
        return Sums(self.gram - other.gram, self.moment - other.moment, self.square - other.square, starts)

    @property
    def within(self) -> "Within":
        """The same of differences to the means of each start."""
        gram, moment, square = self.gram.copy(), self.moment.copy(), self.square
        for _, each in sorted(self.starts.items()):
            gram -= np.outer(each.rows, each.rows) / each.count
            moment -= each.rows * (each.x / each.count)
            square -= each.x * (each.x / each.count)
        free = self.count - len(self.starts)
        return Within(gram / UNIT**2, moment / (UNIT * UNIT_OF_X), square / UNIT_OF_X**2, free)


@dataclass(frozen=True)
class Within:
    """A'A, A'x and x'x of rollouts less the means of their starts, and how many of them are free."""

    gram: Floats
    moment: Floats
    square: float
    free: int

    def first(self, width: int) -> "Within":
        """Return those of the first functions alone."""
        return Within(self.gram[:width, :width], self.moment[:width], self.square, self.free)

    def solved(self, penalty: Floats) -> Floats:
        """Return beta (K,), in units of the range of x."""
        return solve(self.gram + penalty, self.moment)

    def variance(self, beta: Floats) -> float:
        """Return the variance of what is left of a rollout, in units of the squared range of x."""
        terms = (np.outer(beta, beta) * self.gram).ravel().tolist()
        linear = (-2.0 * beta * self.moment).tolist()
        return max(math.fsum([self.square, *linear, *terms]), 0.0) / max(self.free, 1)


def solve(matrix: Floats, right: Floats) -> Floats:
    """Return the solution (K,) for a symmetric positive definite matrix, by Cholesky's decomposition.

    Column by column in numpy's elementwise operations, which round alike everywhere; those of LAPACK do not.

    >>> solve(np.array([[4.0, 2.0], [2.0, 3.0]]), np.array([2.0, 5.0])).round(12).tolist()
    [-0.5, 2.0]

    """
    lower, found = matrix.copy(), right.copy()
    size = len(right)
    for j in range(size):
        lower[j:, j] /= math.sqrt(max(lower[j, j], TINY))
        lower[j + 1 :, j + 1 :] -= lower[j + 1 :, j, None] * lower[None, j + 1 :, j]
    for j in range(size):
        found[j] /= lower[j, j]
        found[j + 1 :] -= lower[j + 1 :, j] * found[j]
    for j in reversed(range(size)):
        found[j] /= lower[j, j]
        found[:j] -= lower[j, :j] * found[j]
    return found


def roughness(knots: int) -> Floats:
    """Return the penalty of squared second differences along so many knots, (m, m).

    >>> roughness(3).tolist()
    [[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]

    """
    differences = np.diff(np.eye(knots), n=2, axis=0)
    return differences.T @ differences if knots > 2 else np.zeros((knots, knots))

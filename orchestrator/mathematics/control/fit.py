"""The fit of a control: penalised least squares on rollouts, the same on every machine.

| symbol | name      | meaning                                                                   | shape   | unit   |
|--------|-----------|---------------------------------------------------------------------------|---------|--------|
| x      |           | value of a rollout                                                        | (n,)    | unit X |
| A      | `rows`    | 1, the start and its squares, then the functions of the disturbances      | (n, K)  | -      |
| beta   |           | minimises |x - A beta|^2 + lambda beta' P beta + a small multiple of |beta|^2 | (K,) | unit X |
| P      | `penalty` | squared second differences along the knots of each disturbance            | (K, K)  | -      |
| lambda |           | chosen by its error on the second half after a fit on the first           | ()      | -      |

Nothing of a fit decides whether a bound holds, only how tight it is. But every machine has to find the same: A and x
are rounded to whole numbers, whose products BLAS sums without any error, and what follows is one operation after the
other, in an order that no library chooses.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats

UNIT = 2.0**15
"""A function of A, at most 1 in size, is a whole number of these."""
UNIT_OF_X = 2.0**20
"""Of the range of x."""
MOST_ROLLOUTS = 2**17
"""With which all sums stay below 2^53; more would fit no better."""
PENALTIES = (0.03, 0.3, 3.0, 30.0)
RIDGE = 1e-3
TINY = 1e-9


@dataclass
class Sums:
    """A'A, A'x and x'x of some rollouts, in whole numbers."""

    gram: Floats
    moment: Floats
    square: float
    count: int

    @classmethod
    def empty(cls, width: int) -> "Sums":
        """Return those of no rollout."""
        return cls(np.zeros((width, width)), np.zeros(width), 0.0, 0)

    def plus(self, rows: Floats, x: Floats) -> "Sums":
        """Return the sums with further rollouts: A (n, K), and x (n,) in units of its range."""
        whole, values = np.rint(rows * UNIT), np.rint(x * UNIT_OF_X)
        gram, moment = whole.T @ whole, whole.T @ values
        return Sums(self.gram + gram, self.moment + moment, self.square + float(values @ values), self.count + len(x))

    def minus(self, other: "Sums") -> "Sums":
        """Return the sums without those of some of the rollouts."""
        return Sums(
            self.gram - other.gram, self.moment - other.moment, self.square - other.square, self.count - other.count
        )

    def solved(self, penalty: Floats) -> Floats:
        """Return beta (K,), in units of the range of x."""
        beta: Floats = solve(self.gram / UNIT**2 + penalty, self.moment / (UNIT * UNIT_OF_X))
        return beta

    def error(self, beta: Floats) -> float:
        """Return the mean square of x - A beta, in units of the squared range of x."""
        gram, moment = self.gram / UNIT**2, self.moment / (UNIT * UNIT_OF_X)
        terms = (np.outer(beta, beta) * gram).ravel().tolist()
        linear = (-2.0 * beta * moment).tolist()
        return max(math.fsum([self.square / UNIT_OF_X**2, *linear, *terms]), 0.0) / max(self.count, 1)


def solve(matrix: Floats, right: Floats) -> Floats:
    """Return the solution (K,) for a symmetric positive definite matrix, by Cholesky's decomposition.

    Column by column in numpy's elementwise operations, which round alike everywhere; those of LAPACK do not.

    >>> solve(np.array([[4.0, 2.0], [2.0, 3.0]]), np.array([2.0, 5.0])).tolist()
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

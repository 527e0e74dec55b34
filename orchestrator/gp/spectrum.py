"""Observations at nodes with repeats merged, and the eigenvalues of their kernel matrix.

| symbol   | name            | meaning                                                       | shape  | unit     |
|----------|-----------------|---------------------------------------------------------------|--------|----------|
| n, q     | `n`, `q`        | observations, distinct observed points                        | ()     | -        |
| X        | `indices`       | distinct observed nodes, in order of first observation        | (q,)   | -        |
| c        | `_counts`       | observations per point                                        | (q,)   | -        |
| ybar     |                 | their means                                                   | (q,)   | unit J   |
| S        | `within`        | sum of squares within the points                              | ()     | unit J^2 |
| e, V     | `values`        | eigenvalues and vectors of diag(sqrt c) K(X, X) diag(sqrt c)  | (q,)   | -        |
| P        | `projector`     | V' diag(sqrt c)                                               | (q, q) | -        |
| u        | `u`             | P ybar                                                        | (q,)   | unit J   |
| eta      | `error`         | bound on the round-off of e, as an error of the matrix        | ()     | -        |

Merging is exact. With K the n x n matrix of all observations, for every a > 0:
y'(K + aI)^-1 y = sum u^2/(e + a) + S/a, ln det(I + K/a) = sum ln(1 + e/a), and with W = P k(X, z)
mu_a(z) = sum W u/(e + a), sigma_a^2(z) = 1 - sum W^2/(e + a).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from orchestrator.gp.kernels import Floats
from orchestrator.gp.lattice import KernelRows
from orchestrator.gp.points import PointRows

ROUND_OFF = 32 * np.finfo(np.float64).eps
"""Backward error of the eigenvalues and of the kernel's values, as a share of the largest eigenvalue."""

LARGEST_Y = 1e100

_FIRST_CAPACITY = 16


@dataclass(frozen=True, slots=True)
class Spectrum:
    """The merged observations in the eigenvectors of their kernel matrix."""

    n: int
    values: Floats
    projector: Floats
    u: Floats
    within: float
    error: float

    def information(self, regulariser: float) -> float:
        """Return ln det(I + K/lambda), rounded up by `error`.

        >>> Spectrum(1, np.array([1.0]), np.eye(1), np.array([0.5]), 0.0, 0.0).information(1.0) == math.log(2.0)
        True
        """
        return float(np.sum(np.log1p((self.values + self.error) / regulariser)))

    def energy(self, regulariser: float, power: int = 1) -> float:
        """Return sum u^2/(e + lambda)^power; with `power` 1 and S/lambda it is y'(K + lambda I)^-1 y."""
        return float(np.sum(self.u**2 / (self.values + regulariser) ** power))


class Observations:
    """Observations at nodes in test order; the state is a function of the calls made."""

    def __init__(self, rows: KernelRows | PointRows) -> None:
        self._rows = rows
        self._order: dict[int, int] = {}
        self._y: list[list[float]] = []
        self._k = np.empty((_FIRST_CAPACITY, rows.size))
        self.n = 0

    @property
    def indices(self) -> list[int]:
        """Distinct observed nodes, in order of first observation."""
        return list(self._order)

    @property
    def kernel(self) -> Floats:
        """K(X, all nodes), shape (q, m)."""
        return self._k[: len(self._y)]

    def append(self, index: int, y: float) -> None:
        """Add the centred observation `y` at node `index`; on an error nothing changes.

        Raises:
            IndexError: no node has this index.
            ValueError: `y` is not finite, or its square could overflow.

        """
        if not abs(y) <= LARGEST_Y:
            raise ValueError(f"observation {self.n} is {y!r}, not a finite number of at most {LARGEST_Y:g}")
        row = self._rows.row(index)
        if index not in self._order:
            self._reserve()
            self._k[len(self._y)] = row
            self._order[index] = len(self._y)
            self._y.append([])
        self._y[self._order[index]].append(y)
        self.n += 1

    def spectrum(self) -> Spectrum:
        """Return the eigenvalues of the merged kernel matrix and the observations in its eigenvectors.

        Cost: O(q^3); the caller keeps the result.
        """
        means = np.array([math.fsum(values) / len(values) for values in self._y])
        within = math.fsum((v - m) ** 2 for values, m in zip(self._y, means.tolist(), strict=True) for v in values)
        root = np.sqrt(np.array([len(values) for values in self._y], dtype=np.float64))
        if not self._y:
            return Spectrum(0, np.empty(0), np.empty((0, 0)), np.empty(0), 0.0, 0.0)
        matrix = root[:, None] * self.kernel[:, self.indices] * root
        values, vectors = eigh(matrix, overwrite_a=True, check_finite=False)
        projector = np.ascontiguousarray(vectors.T * root)
        error = ROUND_OFF * max(1.0, float(values[-1]))
        return Spectrum(self.n, np.maximum(values, 0.0), projector, projector @ means, within, error)

    def _reserve(self) -> None:
        if len(self._y) == len(self._k):
            new = np.empty((2 * len(self._k), self._rows.size))
            new[: len(self._k)] = self._k
            self._k = new

"""The posterior of a Gaussian process over a whole lattice, by row-append Cholesky.

| symbol   | name           | meaning                                              | shape  | unit   |
|----------|----------------|------------------------------------------------------|--------|--------|
| n        | `n`            | number of observations                               | ()     | -      |
| X        | `indices`      | observed nodes, in test order                        | (n,)   | -      |
| y        | `append(., y)` | centred observations J - m0                          | (n,)   | unit J |
| K        |                | kernel matrix of X                                   | (n, n) | -      |
| lambda   | `regulariser`  | added to the diagonal of K                           | ()     | -      |
| L        |                | lower Cholesky factor of K + lambda I                | (n, n) | -      |
| V        | `_v`           | L^-1 K(X, lattice)                                   | (n, m) | -      |
| w        | `_w`           | L^-1 y                                               | (n,)   | unit J |
| d        | `_pivots`      | diagonal of L                                        | (n,)   | -      |
| mu       | `mean`         | V'w                                                  | (m,)   | unit J |
| sigma^2  | `variance`     | 1 - column sums of V^2                               | (m,)   | -      |

Observed points are nodes, so the row of L that belongs to a new point is a column of V and L itself is never stored:
one appended row costs O(n m). A changed lambda costs one factorisation, O(n^3/3 + n^2 m).
"""

import math

import numpy as np
from scipy.linalg.blas import dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from orchestrator.gp.kernels import Floats
from orchestrator.gp.lattice import KernelRows

SMALLEST_PIVOT = 1e-12
"""A squared pivot below this has lost all digits but a few: K + lambda I counts as singular."""

_FIRST_CAPACITY = 16


class SingularKernelError(ValueError):
    """K + lambda I is singular to working precision."""

    def __init__(self, test: int, regulariser: float) -> None:
        super().__init__(
            f"kernel matrix is singular: to round-off, observation {test} is a combination of the earlier ones "
            f"at regulariser {regulariser:g}. Raise the regulariser, lower the resolution, or shorten the length scale"
        )


class Posterior:
    """Mean and variance on every node, given observations at nodes; points may repeat.

    The state is a function of the calls made: the same rows in the same order give the same bits. No jitter is added.
    """

    def __init__(self, rows: KernelRows, regulariser: float) -> None:
        self._rows = rows
        self._indices: list[int] = []
        self._y = np.empty(_FIRST_CAPACITY)
        self._w = np.empty(_FIRST_CAPACITY)
        self._pivots = np.empty(_FIRST_CAPACITY)
        self._k = np.empty((_FIRST_CAPACITY, rows.size))  # K(X, lattice)
        self._v = np.empty((_FIRST_CAPACITY, rows.size))
        self._stale = False
        self._set_moments(np.zeros(rows.size), np.ones(rows.size))
        self._regulariser = _checked(regulariser)

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self._indices)

    @property
    def indices(self) -> tuple[int, ...]:
        """Observed nodes in test order."""
        return tuple(self._indices)

    @property
    def regulariser(self) -> float:
        """The number lambda on the diagonal."""
        return self._regulariser

    @property
    def mean(self) -> Floats:
        """Posterior mean of J - m0 on every node, read-only.
        Implements eq. (GP_mean) of [ARA].

        Formula: mu = k' (K + lambda I)^-1 y = V'w, shape (m,), unit of J.

        Raises:
            SingularKernelError: K + lambda I is singular.

        """
        self._refresh()
        return self._mean

    @property
    def variance(self) -> Floats:
        """Posterior variance on every node, read-only.
        Implements eq. (GP_sigma) of [ARA].

        Formula: k_n(z, z) = 1 - k' (K + lambda I)^-1 k, shape (m,), within [0, 1]. At one lambda no value ever grows.

        Raises:
            SingularKernelError: K + lambda I is singular.

        """
        self._refresh()
        return self._variance

    def regularise(self, value: float) -> None:
        """Change lambda; the factor is rebuilt when a moment is next asked for.

        Raises:
            ValueError: `value` is negative or not finite.

        """
        if _checked(value) != self._regulariser:
            self._regulariser = value
            self._stale = self.n > 0

    def append(self, index: int, y: float) -> None:
        """Add the centred observation `y` at node `index`; on an error nothing changes.

        Raises:
            IndexError: no node has this index.
            ValueError: `y` is not finite.
            SingularKernelError: K + lambda I would be singular.

        """
        if not math.isfinite(y):
            raise ValueError(f"observation {self.n} is {y!r}, not a finite number")
        row = self._rows.row(index)
        self._reserve()
        if not self._stale:
            self._extend(row, index, y)
        self._k[self.n] = row
        self._y[self.n] = y
        self._indices.append(index)

    def information(self, eta: float) -> float:
        """Return ln det((1 + eta) I + K) of the observed points; 0 without any.

        >>> from orchestrator.gp.kernels import Matern
        >>> from orchestrator.gp.lattice import Lattice
        >>> gp = Posterior(Lattice((0.0,), (1.0,), 3).kernel_rows(Matern(2.5, 1.0)), regulariser=1.0)
        >>> gp.append(0, 0.5)
        >>> round(gp.information(2.0), 6) == round(math.log(4.0), 6)
        True

        Raises:
            ValueError: `eta` is below -1 or not finite.
            SingularKernelError: the matrix is singular.

        """
        diagonal = _checked(1.0 + eta)
        if diagonal == self._regulariser:
            self._refresh()
            pivots = self._pivots[: self.n]
        else:
            pivots = _pivots_of(self._factor(diagonal))
        return 2.0 * float(np.sum(np.log(pivots)))

    def _extend(self, row: Floats, index: int, y: float) -> None:
        """Append one row to V, w and d: the new row of L is the column of V at the new point."""
        n, variance = self.n, self._variance
        squared = float(variance[index]) + self._regulariser
        if squared < SMALLEST_PIVOT:
            raise SingularKernelError(n, self._regulariser)
        pivot = math.sqrt(squared)
        column = np.ascontiguousarray(self._v[:n, index])
        v = (row - column @ self._v[:n]) / pivot
        w = (y - float(column @ self._w[:n])) / pivot
        self._v[n], self._w[n], self._pivots[n] = v, w, pivot
        self._set_moments(self._mean + w * v, np.maximum(variance - v * v, 0.0))

    def _refresh(self) -> None:
        """Rebuild V, w, d and the moments from all rows if lambda has changed."""
        if not self._stale:
            return
        n = self.n
        factor = self._factor(self._regulariser)
        self._pivots[:n] = _pivots_of(factor)
        self._w[:n] = dtrsv(factor, self._y[:n], lower=1)
        v = self._v[:n]
        # V' L' = K(X, lattice)': the transposed views are in the Fortran order that BLAS wants.
        v[:] = dtrsm(1.0, factor, self._k[:n].T, side=1, lower=1, trans_a=1).T
        self._set_moments(self._w[:n] @ v, np.maximum(1.0 - np.einsum("ij,ij->j", v, v), 0.0))
        self._stale = False

    def _factor(self, diagonal: float) -> Floats:
        """Return L of K + diagonal I, shape (n, n), in Fortran order; only its lower triangle counts."""
        if not self.n:
            return np.empty((0, 0))
        matrix = self._k[: self.n].take(self._indices, axis=1)  # (n, n)
        matrix.flat[:: self.n + 1] += diagonal
        factor, info = dpotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
        # info > 0 is the order of the first minor that is not positive, counted from 1.
        small = [info - 1] if info > 0 else np.flatnonzero(_pivots_of(factor) ** 2 < SMALLEST_PIVOT)
        if len(small):
            raise SingularKernelError(int(small[0]), diagonal)
        return np.asarray(factor)

    def _set_moments(self, mean: Floats, variance: Floats) -> None:
        mean.flags.writeable = False
        variance.flags.writeable = False
        self._mean, self._variance = mean, variance

    def _reserve(self) -> None:
        """Make room for one more row by doubling; old rows keep their bits."""
        if self.n < len(self._y):
            return
        for name in ("_y", "_w", "_pivots", "_k", "_v"):
            old: Floats = getattr(self, name)
            new = np.empty((2 * len(old), *old.shape[1:]))
            new[: len(old)] = old
            setattr(self, name, new)


def _pivots_of(factor: Floats) -> Floats:
    return np.diagonal(factor).copy()


def _checked(regulariser: float) -> float:
    if not (math.isfinite(regulariser) and regulariser >= 0):
        raise ValueError(f"regulariser must be a finite number >= 0, not {regulariser!r}")
    return regulariser

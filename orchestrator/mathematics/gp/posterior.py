"""Posterior of a Gaussian process over all nodes, by a Cholesky factor that grows by rows.

| symbol   | name           | meaning                                              | shape  | unit   |
|----------|----------------|------------------------------------------------------|--------|--------|
| n, q, X, c, ybar |        | see `gp.observations`                                |        |        |
| y        | `append(., y)` | centred observations J - m0                          | (n,)   | unit J |
| K        |                | kernel matrix of all n observations                  | (n, n) | -      |
| lambda   | `regulariser`  | added to the diagonal of K                           | ()     | -      |
| N        |                | rows of the factor, q <= N <= n                      | ()     | -      |
| s        | `_slots`       | position in X of each row                            | (N,)   | -      |
| b        | `_weights`     | observations that a row represents                   | (N,)   | -      |
| L        | `_factor`      | lower Cholesky factor of K(X, X)[s, s] + diag(lambda/b) | (N, N) | -   |
| w        | `_w`           | L^-1 (mean observation of each row)                  | (N,)   | unit J |
| mu       | `mean`         | K(X[s], .)' L'^-1 w                                  | (m,)   | unit J |
| sigma^2  | `variance`     | 1 - column sums of (L^-1 K(X[s], .))^2               | (m,)   | -      |

A row may represent several observations of a point: their mean, with noise lambda/b, gives exactly the same posterior.
A new observation appends a row of its own; rows are merged once there are twice as many as points.

Cost of an observation: O(q m + q^2), amortised; of a changed lambda: one factorisation, O(q^3/3 + q^2 m). Memory:
O(q (m + q)).
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from .distinct import OffNodeKernel, Point, Rows
from .kernels import Floats
from .observations import Observations
from .triangle import Triangle

SMALLEST_PIVOT = 1e-12
"""A squared pivot below this has lost all digits but a few: K + lambda I counts as singular."""

FEWEST_ROWS = 32
"""Below this, merging rows saves nothing."""


class SingularKernelError(ValueError):
    """K + lambda I is singular to working precision."""

    def __init__(self, test: int, regulariser: float) -> None:
        super().__init__(
            f"kernel matrix is singular: to round-off, observation {test} is a combination of the earlier ones "
            f"at regulariser {regulariser:g}. Raise the regulariser, lower the resolution, or shorten the length scale"
        )


class Posterior:
    """Mean and variance on every node, given observations at nodes or, with `off_nodes`, at any points.

    The state is a function of the calls made: the same ones in the same order give the same bits. No jitter is added.
    """

    def __init__(self, rows: Rows, regulariser: float, off_nodes: OffNodeKernel | None = None) -> None:
        self._data = Observations(rows, off_nodes)
        self._regulariser = _valid_regulariser(regulariser)
        self._stale = False
        self._triangle = Triangle()
        self._slots: list[int] = []
        self._weights: list[float] = []
        self._w: list[float] = []
        self._set_moments(np.zeros(rows.size), np.ones(rows.size))

    @property
    def n(self) -> int:
        """Number of observations."""
        return self._data.n

    @property
    def rows(self) -> int:
        """Number of rows N of the factor."""
        return self._triangle.size

    @property
    def regulariser(self) -> float:
        """The number lambda on the diagonal."""
        return self._regulariser

    @property
    def mean(self) -> Floats:
        """Posterior mean of J - m0 on every node, read-only.
        Implements eq. (GP_mean) of [ARA].

        Formula: mu = k' (K + lambda I)^-1 y, shape (m,), unit of J.

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

    def at(self, z: Sequence[float] | Floats) -> tuple[float, float, Floats, Floats]:
        """Return mean and variance at any point `z` (p,) of the box, and their gradients, shape (p,) each.
        Implements eq. (GP_mean) of [ARA].

        Formula: as `mean` and `variance`; grad k(x, z) = (k'(r)/r) (z - x). Units: J, 1, J and 1 per unit of z.

        Raises:
            SingularKernelError: K + lambda I is singular.

        """
        self._refresh()
        kernel, slopes = self._data.points.gradient(np.asarray(z))  # (q,), (q, p)
        k, slope = kernel[self._slots], slopes[self._slots]
        v, w = self._triangle.solve(k), np.array(self._w)
        mean_weights, gain = self._triangle.solve_transposed(w), self._triangle.solve_transposed(v)
        return float(v @ w), max(0.0, 1.0 - float(v @ v)), mean_weights @ slope, -2.0 * (gain @ slope)

    def regularise(self, value: float) -> None:
        """Change lambda; the factor is rebuilt when a moment is next needed.

        Raises:
            ValueError: `value` is negative or not finite.

        """
        if _valid_regulariser(value) != self._regulariser:
            self._regulariser = value
            self._stale = self.n > 0

    def append(self, point: Point, y: float) -> None:
        """Add the centred observation `y` at `point`; on an error nothing changes.

        Raises:
            IndexError: no node has this index.
            ValueError: `y` is not finite.
            SingularKernelError: K + lambda I would be singular.

        """
        # Every error of `y` and of the pivot comes before the first change.
        self._data.check(y)
        if not self._stale:
            self._extend(point, y)
        position = self._data.append(point, y)
        if not self._stale:
            self._slots.append(position)
            self._weights.append(1.0)
            # A merge costs O(q^3) and needs at least q new rows, hence O(q^2) per observation.
            if len(self._slots) > max(FEWEST_ROWS, 2 * len(self._data.points)):
                self._merge()

    def information(self, eta: float) -> float:
        """Return ln det((1 + eta) I + K) of the observed points; 0 without any.

        Formula: with t = 1 + eta, (n - N) ln t + sum ln b + ln det(K(X, X)[s, s] + diag(t/b)).

        >>> from perfbound.orchestrator.mathematics.gp.kernels import Matern
        >>> from perfbound.orchestrator.mathematics.gp.lattice import Lattice
        >>> gp = Posterior(Lattice((0.0,), (1.0,), 3).kernel_rows(Matern(2.5, 1.0)), regulariser=1.0)
        >>> gp.append(0, 0.5)
        >>> round(gp.information(2.0), 6) == round(math.log(4.0), 6)
        True

        Raises:
            ValueError: `eta` is below -1 or not finite.
            SingularKernelError: the matrix is singular.

        """
        diagonal = _valid_regulariser(1.0 + eta)
        # Under "1+eta" the factor of the posterior is the one needed here; otherwise a second one is made.
        if diagonal == self._regulariser:
            self._refresh()
            pivots, weights = self._triangle.pivots, np.array(self._weights)
        else:
            weights = self._data.counts
            pivots = np.diagonal(self._factor(diagonal))
        repeats = self.n - len(weights)
        rest = repeats * math.log(diagonal) if repeats else 0.0
        return rest + float(np.sum(np.log(weights))) + 2.0 * float(np.sum(np.log(pivots)))

    def _extend(self, point: Point, y: float) -> None:
        """Append one row to L and w, and move the moments."""
        row, among = self._data.points.row(point)
        l = self._triangle.solve(among[self._slots])  # noqa: E741  (the new row of L)
        squared = max(0.0, 1.0 - float(l @ l)) + self._regulariser
        if squared < SMALLEST_PIVOT:
            raise SingularKernelError(self.n, self._regulariser)
        pivot = math.sqrt(squared)
        # L^-1 K(X[s], .) is not stored: its next row follows from the kernel rows by one transposed solve.
        slots = np.array(self._slots, dtype=np.intp)
        gain = np.bincount(slots, self._triangle.solve_transposed(l), minlength=len(self._data.points))  # (q,)
        v = (row - gain @ self._data.points.kernel) / pivot
        w = (y - float(l @ np.array(self._w))) / pivot
        self._triangle.append(l, pivot)
        self._w.append(w)
        # Only subtraction: at one lambda a variance never grows, in floating point either.
        self._set_moments(self._mean + w * v, np.maximum(self._variance - v * v, 0.0))

    def _refresh(self) -> None:
        """Rebuild the factor and the moments from the merged observations if lambda has changed."""
        if not self._stale:
            return
        factor = self._merge()
        # V' L' = K(X, .)': the transposed views are in Fortran order, which BLAS requires.
        v = scipy.linalg.blas.dtrsm(1.0, factor, self._data.points.kernel.T, side=1, lower=1, trans_a=1).T  # (q, m)
        self._set_moments(np.array(self._w) @ v, np.maximum(1.0 - np.einsum("ij,ij->j", v, v), 0.0))
        self._stale = False

    def _merge(self) -> Floats:
        """Rebuild the factor with one row per point, and return it; the moments are the same."""
        # Rebuilt: a downdate for each repeat is of the same order, and an inverse loses digits at a small lambda.
        factor = self._factor(self._regulariser)
        self._triangle = Triangle(factor)
        self._slots, self._weights = list(range(len(self._data.points))), self._data.counts.tolist()
        self._w = self._triangle.solve(self._data.means).tolist()
        return factor

    def _factor(self, diagonal: float) -> Floats:
        """Return L of K(X, X) + diag(diagonal/c), shape (q, q), in Fortran order; only its lower triangle counts."""
        data = self._data
        # With repeats K has two equal rows, which lambda alone keeps apart.
        if data.n > len(data.points) and diagonal < SMALLEST_PIVOT:
            raise SingularKernelError(data.first_repeat, diagonal)
        matrix = data.points.gram.copy()
        matrix.flat[:: len(matrix) + 1] += diagonal / data.counts
        factor, info = scipy.linalg.lapack.dpotrf(matrix.T, lower=1, clean=0, overwrite_a=1) if data.n else (matrix, 0)
        # info > 0 is the order of the first minor that is not positive, counted from 1.
        lost = np.diagonal(factor) ** 2 * data.counts < SMALLEST_PIVOT
        small = [info - 1] if info > 0 else np.flatnonzero(lost)
        if len(small):
            raise SingularKernelError(data.first(int(small[0])), diagonal)
        return np.asarray(factor)

    def _set_moments(self, mean: Floats, variance: Floats) -> None:
        mean.flags.writeable = False
        variance.flags.writeable = False
        self._mean, self._variance = mean, variance


def _valid_regulariser(regulariser: float) -> float:
    if not (math.isfinite(regulariser) and regulariser >= 0):
        raise ValueError(f"regulariser must be a finite number >= 0, not {regulariser!r}")
    return regulariser

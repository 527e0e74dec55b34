"""A lower triangular matrix that grows by rows, and the solution of its linear systems.

| symbol | name     | meaning                    | shape  | unit |
|--------|----------|----------------------------|--------|------|
| N      | `size`   | number of rows             | ()     | -    |
| L      |          | lower triangular matrix    | (N, N) | -    |
|        | `pivots` | its diagonal               | (N,)   | -    |
"""

import numpy as np
import scipy

from .kernels import Floats


class Triangle:
    """A lower triangular matrix, its rows packed in one array, which BLAS reads as the packed upper transpose."""

    def __init__(self, lower: Floats | None = None) -> None:
        self.size = 0 if lower is None else len(lower)
        self._packed = np.empty(16) if lower is None else lower[np.tril_indices(self.size)]

    @property
    def pivots(self) -> Floats:
        """The diagonal, shape (N,)."""
        steps = np.arange(1, self.size + 1)
        return np.asarray(self._packed[steps * (steps + 1) // 2 - 1], dtype=np.float64)

    def append(self, row: Floats, pivot: float) -> None:
        """Add a row, shape (N,), and its diagonal entry."""
        start = self._length
        self.size += 1
        # Doubling keeps the cost of growth amortised; rows that exist keep their bits.
        if self._length > len(self._packed):
            self._packed = np.concatenate([self._packed[:start], np.empty(self._length)])
        self._packed[start : self._length - 1] = row
        self._packed[self._length - 1] = pivot

    def solve(self, x: Floats) -> Floats:
        """Return L^-1 x, shape (N,)."""
        return self._solve(x, transposed=1)

    def solve_transposed(self, x: Floats) -> Floats:
        """Return L'^-1 x, shape (N,)."""
        return self._solve(x, transposed=0)

    @property
    def _length(self) -> int:
        return self.size * (self.size + 1) // 2

    def _solve(self, x: Floats, *, transposed: int) -> Floats:
        if not self.size:  # BLAS refuses a matrix of order 0
            return np.empty(0)
        solution = scipy.linalg.blas.dtpsv(self.size, self._packed[: self._length], x, lower=0, trans=transposed)
        return np.asarray(solution, dtype=np.float64)

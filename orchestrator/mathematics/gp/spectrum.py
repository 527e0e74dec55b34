"""Merged observations in the eigenvectors of their kernel matrix.

| symbol   | name            | meaning                                                       | shape  | unit     |
|----------|-----------------|---------------------------------------------------------------|--------|----------|
| n, q, X, c, ybar, S |      | see `gp.observations`                                         |        |          |
| e, V     | `values`        | eigenvalues and vectors of diag(sqrt c) K(X, X) diag(sqrt c)  | (q,)   | -        |
| P        | `projector`     | V' diag(sqrt c)                                               | (q, q) | -        |
| u        | `u`             | P ybar                                                        | (q,)   | unit J   |
| eta      | `error`         | bound on the round-off of e, as an error of the matrix        | ()     | -        |

Merging is exact. With K the n x n matrix of all observations, for every a > 0:
y'(K + aI)^-1 y = sum u^2/(e + a) + S/a, ln det(I + K/a) = sum ln(1 + e/a), and with W = P k(X, z)
mu_a(z) = sum W u/(e + a), sigma_a^2(z) = 1 - sum W^2/(e + a).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from .kernels import Floats
from .observations import Observations

ROUND_OFF = 32 * np.finfo(np.float64).eps
"""Backward error of the eigenvalues and of the kernel's values, as a share of the largest eigenvalue."""


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

        >>> round(Spectrum(1, np.array([1.0]), np.eye(1), np.array([0.5]), 0.0, 0.0).information(1.0), 6)
        0.693147
        """
        return float(np.sum(np.log1p((self.values + self.error) / regulariser)))

    def energy(self, regulariser: float, power: int = 1) -> float:
        """Return sum u^2/(e + lambda)^power; with `power` 1 and S/lambda it is y'(K + lambda I)^-1 y."""
        return float(np.sum(self.u**2 / (self.values + regulariser) ** power))


def decompose(data: Observations) -> Spectrum:
    """Return the eigenvalues of the merged kernel matrix and the observations in its eigenvectors.

    Cost: O(q^3); the caller keeps the result.
    """
    if not data.n:
        return Spectrum(0, np.empty(0), np.empty((0, 0)), np.empty(0), 0.0, 0.0)
    # Symmetric scaling: the eigenvalues of the n x n matrix of all observations that are not 0.
    root = np.sqrt(data.counts)
    matrix = root[:, None] * data.points.gram * root
    values, vectors = scipy.linalg.eigh(matrix, overwrite_a=True, check_finite=False)
    projector = np.ascontiguousarray(vectors.T * root)
    error = ROUND_OFF * max(1.0, float(values[-1]))
    # K is positive semidefinite: eigenvalues below 0 are round-off, which `error` bounds.
    return Spectrum(data.n, np.maximum(values, 0.0), projector, projector @ data.means, data.within, error)

"""Length scales by maximum likelihood, for a kernel of given smoothness.

| symbol | name        | meaning                                                             | shape | unit   |
|--------|-------------|---------------------------------------------------------------------|-------|--------|
| y, u, l |            | see `sampled`; y is centred here                                    |       |        |
| A      | `amplitude` | standard deviation of the Gaussian process                          | ()    | unit J |
| lambda | `ratio`     | variance of the noise of y, in units of A^2                         | ()    | -      |
|        | `gain`      | log-likelihood above that of values without any structure           | ()    | -      |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ..blocks import blocks
from ..gp.kernels import Floats
from .sampled import SampledValues, kernel_matrix, unit_kernel

MOST = 160
"""Values that a fit uses; its time grows with the cube, and length scales need no more."""
SHORTEST, LONGEST = 0.03, 2.0
"""Length scales that are tried, as shares of the ranges."""
STARTS = (0.5, 0.15)
"""Length scales from which the search begins."""
EXACT_RATIO = 1e-8
"""lambda of exact values: norms stay lower bounds, and the kernel matrix regular."""
LEAST_RATIO, LARGEST_RATIO = 1e-6, 1e3


@dataclass(frozen=True, slots=True)
class KernelFit:
    """A kernel that fits the values best, for its smoothness."""

    nu: float
    lengths: Floats
    ratio: float
    amplitude: float
    gain: float

    def factor(self, data: SampledValues) -> Floats:
        """Return the lower factor of K + lambda I at the starts of `data`, (n, n)."""
        gram = kernel_matrix(self.nu, self.lengths, data.shares, data.shares)
        gram[np.diag_indices(len(gram))] += self.ratio
        return np.asarray(scipy.linalg.cholesky(gram, lower=True, check_finite=False))

    def weights(self, data: SampledValues, centre: float) -> Floats:
        """Return w of the posterior mean m0 + sum_i w_i k(., u_i), shape (n,)."""
        return np.asarray(scipy.linalg.cho_solve((self.factor(data), True), data.values - centre, check_finite=False))

    def mean(self, data: SampledValues, shares: Floats) -> Floats:
        """Return the posterior mean at starts (m, p), in the unit of the values."""
        centre = float(data.values.mean())
        weights = self.weights(data, centre)
        # A lattice has so many nodes that their kernel with all starts would be the largest array of a calibration.
        parts = [
            kernel_matrix(self.nu, self.lengths, shares[part], data.shares) @ weights
            for part in blocks(len(shares), len(weights))
        ]
        return np.asarray(centre + np.concatenate(parts), dtype=np.float64)

    def covariance(self, data: SampledValues, shares: Floats) -> Floats:
        """Return the posterior covariance at starts (m, p), shape (m, m), in the square of the unit of the values."""
        between = kernel_matrix(self.nu, self.lengths, data.shares, shares)
        half = scipy.linalg.solve_triangular(self.factor(data), between, lower=True, check_finite=False)
        own = kernel_matrix(self.nu, self.lengths, shares, shares)
        return np.asarray(self.amplitude**2 * (own - half.T @ half), dtype=np.float64)

    def error(self, data: SampledValues, share: Floats) -> float:
        """Return the standard error of the posterior mean at one start (p,), in the unit of the values."""
        return math.sqrt(max(float(self.covariance(data, share[None])[0, 0]), 0.0))


def fit_kernel(nu: float, data: SampledValues) -> KernelFit:
    """Return the kernel of smoothness `nu` with the largest likelihood, A profiled out; unit of A that of the values.

    Formula: maximise -n/2 ln(y'(K + lambda I)^-1 y/n) - 1/2 ln det(K + lambda I) over ln l and, with noise, ln lambda.

    Raises:
        ValueError: all values are equal, and no length scale follows from them.

    """
    used = data.first(MOST)
    y = used.values - used.values.mean()
    if not np.ptp(y) > 0:
        raise ValueError("all values are equal")
    n, p = used.shares.shape
    squares = (used.shares[:, None, :] - used.shares[None, :, :]) ** 2
    kernel = unit_kernel(nu)

    def factored(logs: Floats) -> tuple[Floats, float]:
        gram = kernel.value(np.sqrt(squares @ np.exp(-2.0 * logs[:p])))
        # No fitted noise for exact values: it would hide kinks and holes.
        gram[np.diag_indices(n)] += math.exp(logs[p]) if len(logs) > p else EXACT_RATIO
        lower = scipy.linalg.cholesky(gram, lower=True, check_finite=False)
        half = scipy.linalg.solve_triangular(lower, y, lower=True, check_finite=False)
        return lower, max(float(half @ half) / n, 1e-300)

    def loss(logs: Floats) -> float:
        try:
            lower, square = factored(logs)
        except np.linalg.LinAlgError:
            return 1e10  # not reached with these ratios; a search must not end for one point
        return float(0.5 * n * math.log(square) + np.sum(np.log(np.diag(lower))))

    # By likelihood and not by the variogram: a box shorter than the length scale of a function shows no sill.
    logs = _least(loss, p, noisy=not data.exact)
    _, square = factored(logs)
    without = 0.5 * n * math.log(float(y @ y) / n)  # K = 0: all of it is noise
    return KernelFit(
        nu,
        np.exp(logs[:p]),
        math.exp(logs[p]) if len(logs) > p else EXACT_RATIO,
        math.sqrt(square),
        without - loss(logs),
    )


def _least(loss: Callable[[Floats], float], dimension: int, *, noisy: bool) -> Floats:
    from scipy.optimize import minimize  # noqa: PLC0415  (most commands fit no kernel)

    limits = [(math.log(SHORTEST), math.log(LONGEST))] * dimension
    limits += [(math.log(LEAST_RATIO), math.log(LARGEST_RATIO))] if noisy else []
    found = [
        minimize(
            loss,
            [math.log(start)] * dimension + ([math.log(0.1)] if noisy else []),
            bounds=limits,
            method="L-BFGS-B",
            options={"maxiter": 30},
        )
        for start in STARTS
    ]
    return np.asarray(min(found, key=lambda each: float(each.fun)).x, dtype=np.float64)

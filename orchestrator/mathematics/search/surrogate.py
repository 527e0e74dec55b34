"""A Gaussian process whose scale, mean, noise and length scales follow the data: the model of a search.

Unlike `gp.posterior`, whose constants are assumptions of a claim, nothing here is one.

| symbol | name      | meaning                                                        | shape    | unit |
|--------|-----------|----------------------------------------------------------------|----------|------|
| n, p   |           | tests, parameters                                              | ()       | -    |
| X      | `points`  | tests in the unit box                                          | (n, p)   | -    |
| z      | `values`  | warped robustness                                              | (n,)     | -    |
| l      | `lengths` | length scales                                                  | (p,)     | -    |
| g      | `nugget`  | variance of noise and jumps, relative to the signal's           | ()       | -    |
| K      |           | Matern kernel of X/l, plus g on the diagonal                   | (n, n)   | -    |
| b      |           | 1'K^-1 z / 1'K^-1 1, the mean (generalised least squares)      | ()       | -    |
| q      |           | (z - b)'K^-1 (z - b)                                           | ()       | -    |
| s^2    |           | (q + 1)/(n + 1), the variance, as if of one more unit value    | ()       | -    |
| theta  |           | (ln l, ln g)                                                   | (p + 1,) | -    |

theta minimises (n + 1)/2 ln s^2 + 1/2 ln det K + |(theta - mode)/sd|^2/2: the likelihood with b and s^2 at their best
values, and a normal prior, without which two tests would decide p length scales.
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from ..gp.kernels import Floats, Matern
from ..gp.radial import Radial

KERNEL = Radial(Matern(nu=1.5, length_scale=1.0))
"""Rough, since margins of closed loops have kinks: the smallest over time of several signals."""
# With 0.5 and 1 searches took 6 and 16 % more tests, on functions that no benchmark has.
LENGTH, LENGTH_SD = 0.3, 0.7
"""Median of the prior of l in one dimension, it grows with sqrt(p); standard deviation of its logarithm."""
NUGGET, NUGGET_SD = 1e-4, 2.0
BOUNDS = ((math.log(0.02), math.log(30.0)), (math.log(1e-6), math.log(0.5)))
"""Of each ln l, and of ln g."""
STEPS = 25
"""Steps of the optimiser."""


def prior_mode(dimension: int) -> Floats:
    """Return the mode of the prior of theta, shape (p + 1,)."""
    return np.array([math.log(LENGTH * math.sqrt(dimension))] * dimension + [math.log(NUGGET)])


def fitted(points: Floats, values: Floats, theta: Floats) -> Floats:
    """Return the best theta (p + 1,), sought from the given one and from the mode of the prior."""
    from scipy.optimize import minimize  # noqa: PLC0415  (a tenth of a second that few commands need)

    dimension = points.shape[1]
    squares = np.stack([(column[:, None] - column[None, :]) ** 2 for column in points.T])  # (p, n, n)
    mode, sd = prior_mode(dimension), np.array([LENGTH_SD] * dimension + [NUGGET_SD])

    def objective(candidate: Floats) -> tuple[float, Floats]:
        value, gradient = _likelihood(candidate, squares, values)
        distance = (candidate - mode) / sd
        return value + 0.5 * float(distance @ distance), gradient + distance / sd

    bounds = [BOUNDS[0]] * dimension + [BOUNDS[1]]
    found = [
        minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS})
        for start in (theta, mode)
    ]
    return np.asarray(min(found, key=lambda each: float(each.fun)).x, dtype=np.float64)


def _likelihood(theta: Floats, squares: Floats, values: Floats) -> tuple[float, Floats]:
    """Return the negative logarithm of the likelihood and its gradient (p + 1,).

    Formula: with W = K^-1 - a a'/s^2 and a = K^-1 (z - b), d/dtheta = tr(W dK/dtheta)/2, where dK/d ln l_j is
    -(k'(r)/r) (x_j - x'_j)^2/l_j^2 and dK/d ln g is g I.
    """
    n, scales, nugget = len(values), np.exp(-2.0 * theta[:-1]), math.exp(theta[-1])
    r = np.sqrt(np.tensordot(scales, squares, 1))
    factor = _factor(KERNEL.value(r), nugget)
    inverse = np.tril(scipy.linalg.lapack.dpotri(factor, lower=1)[0])
    inverse += np.tril(inverse, -1).T
    sums = inverse.sum(axis=1)
    centred = values - float(sums @ values) / float(sums.sum())
    a = inverse @ centred
    variance = (float(centred @ a) + 1.0) / (n + 1)
    w = inverse - np.outer(a, a) / variance
    # A matrix of rank one per parameter would be slower: the sums over all pairs are one product each.
    slopes = np.tensordot(squares, w * KERNEL.slope(r), 2)
    gradient = np.append(-0.5 * scales * slopes, 0.5 * nugget * np.trace(w))
    return 0.5 * (n + 1) * math.log(variance) + float(np.sum(np.log(np.diagonal(factor)))), gradient


class Surrogate:
    """Posterior of the warped robustness given tests, and given tests in flight, of which only the place is known.

    A test in flight counts as observed at its expected value: it moves no mean, and takes its variance away.
    """

    def __init__(self, theta: Floats, points: Floats, values: Floats, pending: Sequence[Floats] = ()) -> None:
        self.lengths, nugget = np.exp(theta[:-1]), math.exp(theta[-1])
        self._n = len(points)
        self._points = np.vstack([points, *pending]) / self.lengths  # (n + tests in flight, p)
        self._factor = _factor(KERNEL.value(scipy.spatial.distance.cdist(self._points, self._points)), nugget)
        # The leading block of a Cholesky factor is the factor of the leading block: that of the observed tests.
        observed = np.asfortranarray(self._factor[: self._n, : self._n])
        weights = scipy.linalg.lapack.dpotrs(observed, np.stack([np.ones(self._n), values], axis=1), lower=1)[0]
        self._mean = float(weights[:, 1].sum()) / float(weights[:, 0].sum())
        self._weights = weights[:, 1] - self._mean * weights[:, 0]
        self._variance = (float((values - self._mean) @ self._weights) + 1.0) / (self._n + 1)

    def moments(self, points: Floats) -> tuple[Floats, Floats]:
        """Return mean and standard deviation, shape (m,) each, at points (m, p) of the unit box."""
        kernel = KERNEL.value(scipy.spatial.distance.cdist(self._points, points / self.lengths))  # (n, m)
        mean = self._mean + self._weights @ kernel[: self._n]
        half = scipy.linalg.lapack.dtrtrs(self._factor, kernel, lower=1)[0]
        share = np.maximum(1.0 - np.einsum("ij,ij->j", half, half), 1e-12)
        return np.asarray(mean), np.asarray(np.sqrt(self._variance * share))


def _factor(kernel: Floats, nugget: float) -> Floats:
    """Return the lower Cholesky factor of the kernel matrix with the nugget, in Fortran order."""
    kernel.flat[:: len(kernel) + 1] += nugget
    factor, info = scipy.linalg.lapack.dpotrf(kernel.T, lower=1, overwrite_a=1)
    # With a nugget of 1e-6 and a kernel of smoothness 1.5, no matrix of a few hundred tests is singular.
    assert info == 0
    return np.asarray(factor)

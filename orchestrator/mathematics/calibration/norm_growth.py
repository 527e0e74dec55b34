"""The norm that the values need, against their number: it levels off where the kernel fits, and rises elsewhere.

| symbol | name     | meaning                                                                | shape | unit   |
|--------|----------|------------------------------------------------------------------------|-------|--------|
| n_j    | `sizes`  | numbers of starts, each about twice the one before                     | (k,)  | -      |
| b_j    | `norms`  | norm that the first n_j values need                                    | (k,)  | unit J |
| b      | `limit`  | norm to which the trend leads                                          | ()    | unit J |

Without noise b_j is a lower bound of the norm of J - m0, whatever J is. With noise it is the norm of the posterior
mean, an estimate.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats
from .kernel_fit import KernelFit
from .sampled import SampledValues, kernel_matrix

DOUBLINGS = 3
LEAST_RATIO, LARGEST_RATIO = 0.25, 0.8
"""Of the increments of two doublings, between which their trend is continued."""


@dataclass(frozen=True, slots=True)
class NormGrowth:
    """The norm at each resolution, and where it leads."""

    sizes: tuple[int, ...]
    norms: tuple[float, ...]
    limit: float

    @property
    def last(self) -> float:
        """Factor by which the last doubling of the starts raised the norm."""
        return self.norms[-1] / max(self.norms[-2], 1e-300)

    @property
    def last_two(self) -> float:
        """Factor of the last two doublings."""
        return self.norms[-1] / max(self.norms[-3], 1e-300)


def sizes_of(count: int) -> tuple[int, ...]:
    """Return the numbers of starts of a design, each half of the next one.

    >>> sizes_of(376)
    (47, 94, 188, 376)
    """
    return tuple(count // 2**k for k in range(DOUBLINGS, -1, -1))


def needed_norm(fit: KernelFit, data: SampledValues, centre: float) -> float:
    """Return the norm that values need, in their unit: a lower bound without noise, else that of the posterior mean.

    Formula: sqrt(y'(K + lambda I)^-1 y), or with w = (K + lambda I)^-1 y, sqrt(w'K w); y = values - centre.
    """
    weights = fit.weights(data, centre)
    if data.exact:
        square = float((data.values - centre) @ weights)
    else:
        square = float(weights @ kernel_matrix(fit.nu, fit.lengths, data.shares, data.shares) @ weights)
    return math.sqrt(max(square, 0.0))


def norm_growth(fit: KernelFit, data: SampledValues, centre: float) -> NormGrowth:
    """Return the norm at every resolution, and its limit, in the unit of the values.

    Formula: increments of the squared norm that fall by a factor q with every doubling sum up to b_k^2 + D q/(1 - q),
    D the last one; q is taken from the last two, and between 1/4 and 4/5.
    """
    sizes = sizes_of(len(data.values))
    norms = tuple(needed_norm(fit, data.first(size), centre) for size in sizes)
    squares = np.square(norms)
    before, last = (max(float(each), 0.0) for each in np.diff(squares)[-2:])
    ratio = min(max(last / before if before > 0 else 0.0, LEAST_RATIO), LARGEST_RATIO)
    return NormGrowth(sizes, norms, math.sqrt(float(squares[-1]) + last * ratio / (1.0 - ratio)))


def refined(data: SampledValues, shares: Floats, values: Floats) -> SampledValues:
    """Return the starts together with others at a finer resolution (m, p), whose values (m,) are as exact."""
    return SampledValues(np.vstack([data.shares, shares]), np.concatenate([data.values, values]), data.variance)

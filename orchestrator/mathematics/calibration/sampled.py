"""The values that constants are calibrated from, and the kernel matrix of their starts.

| symbol | name       | meaning                                                        | shape  | unit   |
|--------|------------|----------------------------------------------------------------|--------|--------|
| u      | `shares`   | starts, each parameter as a share of its range                 | (n, p) | -      |
| y      | `values`   | mean of J at a start, over its rollouts                        | (n,)   | unit J |
| v      | `variance` | variance of such a mean; 0 where rollouts are exact            | ()     | unit J^2 |
| l_j    | `lengths`  | length scales, as shares of the ranges                         | (p,)   | -      |
"""

from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats, Matern, squared_distances
from ..gp.radial import Radial


@dataclass(frozen=True, slots=True)
class SampledValues:
    """Values of the objective at space-filling starts; any first part of them fills the space as well."""

    shares: Floats
    values: Floats
    variance: float

    @property
    def exact(self) -> bool:
        """Whether the values are those of the objective, without noise."""
        return self.variance == 0

    def first(self, count: int) -> "SampledValues":
        """Return the first `count` starts: the same design at a lower resolution."""
        return SampledValues(self.shares[:count], self.values[:count], self.variance)


def unit_kernel(nu: float) -> Radial:
    """Return the kernel of distances in length scales."""
    return Radial(Matern(nu, 1.0))


def kernel_matrix(nu: float, lengths: Floats, first: Floats, second: Floats) -> Floats:
    """Return the kernel between starts (n, p) and (m, p), shape (n, m)."""
    return unit_kernel(nu).value(np.sqrt(squared_distances(first, second, lengths)))

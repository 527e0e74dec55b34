"""The variogram: how much values differ, by the distance of their starts.

| symbol | name        | meaning                                                     | shape | unit     |
|--------|-------------|-------------------------------------------------------------|-------|----------|
| r      | `distances` | mean distance of the pairs of a class, in length scales     | (c,)  | -        |
| g      | `halves`    | mean of (y_i - y_j)^2 / 2 over the pairs of a class         | (c,)  | unit J^2 |
| g(r)   | `fitted`    | a (1 - k(r)) + v, a >= 0 by least squares                    | (c,)  | unit J^2 |
"""

from dataclasses import dataclass

import numpy as np

from ..gp.kernels import Floats
from .kernel_fit import KernelFit
from .sampled import SampledValues, unit_kernel

CLASSES = 15
FARTHEST = 0.75
"""Quantile of the distances beyond which too few starts make pairs."""


@dataclass(frozen=True, slots=True)
class Variogram:
    """The variogram of the values, and that of a kernel."""

    distances: Floats
    halves: Floats
    fitted: Floats


def variogram(fit: KernelFit, data: SampledValues) -> Variogram:
    """Return the variogram in classes with equally many pairs, in the squared unit of the values."""
    scaled = data.shares / fit.lengths
    first, second = np.triu_indices(len(scaled), 1)
    distances = np.linalg.norm(scaled[first] - scaled[second], axis=1)
    halves = (data.values[first] - data.values[second]) ** 2 / 2.0
    order = np.argsort(distances, kind="stable")[: int(FARTHEST * len(distances))]
    parts = np.array_split(order, CLASSES)
    r = np.array([distances[part].mean() for part in parts])
    g = np.array([halves[part].mean() for part in parts])
    shape = 1.0 - unit_kernel(fit.nu).value(r)
    # The starts may cover less than a length scale: their own spread is then less than the amplitude of the process.
    factor = max(float(shape @ (g - data.variance)) / float(shape @ shape), 0.0)
    return Variogram(r, g, factor * shape + data.variance)

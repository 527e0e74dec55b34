"""Random numbers of many rollouts at once for simulators, each from its own seed; see `schemas.draws.counter`."""

import numpy as np
from numpy.typing import ArrayLike

from ...schemas.draws.counter import Floats, uniform

__all__ = ["normal", "uniform"]


def normal(seeds: ArrayLike, count: int, *, stream: int = 0) -> Floats:
    """Return standard normal numbers, otherwise as `uniform`, by the transform of Box and Muller.

    >>> normal([7, 8], 3).shape
    (2, 3)

    """
    pairs = uniform(seeds, count + count % 2 if count > 0 else count, stream=stream)
    # Copies: numpy may round a logarithm or cosine otherwise where its numbers are not side by side.
    first, second = pairs[:, ::2].copy(), pairs[:, 1::2].copy()
    # 1 - u is above 0, where the logarithm is finite.
    radius, angle = np.sqrt(-2.0 * np.log1p(-first)), 2.0 * np.pi * second
    pairs[:, ::2], pairs[:, 1::2] = radius * np.cos(angle), radius * np.sin(angle)
    return pairs[:, :count]

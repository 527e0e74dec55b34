"""The Sobol sequence: points that fill the unit cube evenly, without chance."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

BLOCK = 2**12
"""Points computed together; the sequence is the same for every size."""
MOST_BLOCKS = 2**14
"""The sequence of 30 bits ends behind many more."""


def sobol_blocks(dimension: int) -> Iterator[NDArray[np.float64]]:
    """Yield the points of the unscrambled sequence in [0, 1)^dimension, `BLOCK` of them at a time, (n, p).

    Their coordinates are whole multiples of 2^-30: the same on all machines.

    >>> next(sobol_blocks(2))[:4].tolist()
    [[0.0, 0.0], [0.5, 0.5], [0.75, 0.25], [0.25, 0.75]]
    """
    from scipy.stats import qmc  # noqa: PLC0415  (a second of start-up that few commands need)

    engine = qmc.Sobol(dimension, scramble=False)
    for _ in range(MOST_BLOCKS):
        yield engine.random(BLOCK)

"""The ends of the bars of a histogram of the robustness."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

BINS = 40
"""At most so many bars, about."""

NEAR = 0.5
"""The axis begins at 0 where the least value is at most this share of the spread above it."""


def edges_over(low: float, high: float, values: tuple[float, float]) -> list[float]:
    """Return the ends of bars from `low` to `high`, from 0 where the least of the `values` (their ends) is near it."""
    # The requirement is at 0: worth showing where it is near.
    return edges(min(low, 0.0) if values[0] <= NEAR * (values[1] - values[0]) else low, high)


def edges(low: float, high: float) -> list[float]:
    """Return the ends of the bars: multiples of 1, 2 or 5 times a power of ten, so that 0 is one of them.

    >>> edges(-0.3, 1.2)[:3], len(edges(-0.3, 1.2))
    ([-0.3, -0.25, -0.2], 32)
    """
    least = (high - low) / BINS or abs(low) / BINS or 1.0
    power = 10.0 ** math.floor(math.log10(least))
    width = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least)
    first, last = math.floor(low / width + 1e-9), math.floor(high / width + 1e-9) + 1
    return [float(f"{k * width:.12g}") for k in range(first, last + 1)]


def bar_counts(values: ArrayLike, ends: Sequence[float]) -> list[int]:
    """Return the number of values in each bar; one that is an end belongs to the bar above it.

    >>> bar_counts([-0.1, 0.0, 0.2, 0.3], [-0.2, 0.0, 0.2, 0.4])
    [1, 1, 2]
    """
    place = np.searchsorted(np.array(ends), np.asarray(values), side="right") - 1
    bars = len(ends) - 1
    found: list[int] = np.bincount(np.clip(place, 0, bars - 1), minlength=bars).tolist()
    return found

"""Times of samples, and the inputs of the competition from a point: held over equal intervals, or linear."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def every(step: float, end: float) -> Floats:
    """Return the times from 0 to `end`, a multiple of `step`."""
    return np.linspace(0.0, round(end / step) * step, round(end / step) + 1)


def held(values: Floats, end: float, times: Floats) -> Floats:
    """Return the signal that holds each of `values` for an equal share of [0, `end`], and the last one after it."""
    # A time that rounding puts a hair before the border of an interval belongs to the next one.
    index = np.floor(times * (len(values) / end) + 1e-9).astype(int)
    signal: Floats = values[np.minimum(index, len(values) - 1)]
    return signal


def linear(values: Floats, end: float, times: Floats) -> Floats:
    """Return the signal that is linear between `values` at equally spaced knots on [0, `end`]."""
    return np.interp(times, np.linspace(0.0, end, len(values)), values)

"""Sums, squares and readings of many values, to the bit those of Python's numbers one by one.

| symbol | name     | meaning                                                       | shape | unit |
|--------|----------|---------------------------------------------------------------|-------|------|
| v      | `values` | finite values                                                 | (k,)  | any  |
| e      |          | |v| <= 2^e                                                    | ()    | -    |
| u      |          | 2^(e - 37)                                                    | ()    | any  |
| h      | `high`   | v rounded to a multiple of u: (v + c) - c with c = 1.5 2^52 u | (k,)  | any  |

2^14 multiples of u, none above 2^e, have partial sums up to 2^51 u, so that every order of adding them is exact. v - h
is exact as well and at most u/2: two or three rounds leave nothing of most values. `math.fsum` of a few exact sums is
the double next to the whole sum, as it is of the values themselves.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...gp.kernels import Floats
from .risk import RiskReading

PIECE = 2**14
"""Values that are taken at a time; as Python numbers they have four times the size."""
ROUNDS = 3
FEW = 1000
"""Values that `math.fsum` adds up faster than the calls of numpy take."""


def pieces(values: Floats) -> Iterator[Floats]:
    """Yield the values (k,) in pieces, in their order."""
    for first in range(0, len(values), PIECE):
        yield values[first : first + PIECE]


def exact_sum(values: Floats) -> float:
    """Return `math.fsum` of finite values (k,), up to the sign of a zero.

    Formula: at the head of this module. Exact for values up to 2^1000.

    >>> exact_sum(np.array([1e16, 1.0, -1e16, 1e-300])), exact_sum(np.full(10, 0.1))
    (1.0, 1.0)

    """
    if len(values) <= FEW:
        return math.fsum(values.tolist())
    sums: list[float] = []
    for piece in pieces(values):
        rest = piece
        for _ in range(ROUNDS):
            largest = max(float(rest.max()), -float(rest.min()))
            if not largest:
                break
            centre = math.ldexp(1.5, math.frexp(largest)[1] + 15)
            high = (rest + centre) - centre
            sums.append(float(high.sum()))
            rest = rest - high
        else:
            sums.extend(rest[rest != 0.0].tolist())
    return math.fsum(sums)


def squares(values: Floats) -> Floats:
    """Return `value ** 2` of each value (k,).

    Python calls pow of the C library, which differs from a product in the last bit of one value in a thousand; of
    numpy's functions `float_power` alone does so on every CPU.
    """
    return np.asarray(np.float_power(values, 2.0), dtype=np.float64)


def linearised_each(values: Floats, squared: Floats, risk_weight: float, s: float) -> Floats:
    """Return `linearised` of each value; `squared` are the squares of value - c."""
    return values - 0.5 * risk_weight * (squared / s + s)


def units(values: Floats, reading: RiskReading) -> Floats:
    """Return x in [0, 1] of robustness within the clip, (k,), as the reading reads it."""
    low, high = reading.ends
    moved = values
    if reading.constants is not None:
        c, s = reading.constants
        moved = linearised_each(values, squares(values - c), reading.risk_weight, s)
    return np.minimum(np.maximum((moved - low) / (high - low), 0.0), 1.0)  # leaves [0, 1] by rounding at most


def are_within(values: Floats | NDArray[np.int64], low: float, high: float) -> bool:
    """Whether all values, at least one, are in [low, high]; what is not a number is nowhere."""
    # For few values a third of the time of `min` and `max`; the place of a NaN is that of both.
    return bool(values.item(values.argmin()) >= low and values.item(values.argmax()) <= high)

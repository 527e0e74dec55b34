"""Distributions of one parameter, truncated to a range: the inverse transform of uniform numbers.

| symbol | name     | meaning                                         | shape | unit      |
|--------|----------|-------------------------------------------------|-------|-----------|
| u      | `shares` | numbers in [0, 1)                               | (n,)  | -         |
| F      | `before` | distribution before the truncation              |       |           |
| a, b   | `low`, `high` | ends of the range                          | ()    | parameter |
| x      |          | F^-1(F(a) + u (F(b) - F(a))), clipped to [a, b] | (n,)  | parameter |
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from ..values import DistributionName

Floats = NDArray[np.float64]
Inverse = Callable[[Floats], Floats]
LEAST = 1e-9
"""Least probability of a range: below it the range, or a unit, is a mistake, and F(b) - F(a) loses its digits."""


def truncated(
    name: DistributionName,
    keys: Mapping[str, float],
    low: float,
    high: float,
    *,
    beyond: float = 0.0,
    before: Any | None = None,
) -> Inverse:
    """Return the inverse of the distribution `name` with its `keys`, truncated to [low, high]: shares (n,) to values.

    With `beyond` the range of the truncation, not the distribution, is longer by so much at both ends. `before` is a
    frozen distribution of scipy in place of `name` and `keys`.

    Raises:
        ValueError: less than `LEAST` of the distribution is in the range.

    >>> truncated("triangular", {"mode": 5.0}, 0.0, 10.0)(np.array([0.0, 0.125, 0.5])).tolist()
    [0.0, 2.5, 5.0]

    """
    before = before or frozen(name, keys, low, high)
    low, high = low - beyond, high + beyond
    if before is None:
        # Basic arithmetic alone: equal on all machines.
        return lambda shares: np.clip(low + shares * (high - low), low, high)
    # The upper tail by its own functions: near 1 a probability has no digits left.
    upper = bool(before.cdf(low) > 0.5)
    first, last = (before.sf(low), before.sf(high)) if upper else (before.cdf(low), before.cdf(high))
    inverse = before.isf if upper else before.ppf
    if not abs(last - first) >= LEAST:
        raise ValueError(f"less than {LEAST:g} of the distribution is in [{low:g}, {high:g}]")
    return lambda shares: np.clip(inverse(first + shares * (last - first)), low, high)


def to_digits(values: Floats, low: float, high: float, digits: int) -> list[float]:
    """Return values of [low, high] with `digits` significant digits, still in [low, high].

    The digits are those of the value, or of the width of the range if that is less: a narrow range far from 0 keeps
    its values apart.

    >>> to_digits(np.array([0.123456789, 123.456789]), 0.0, 200.0, 4)
    [0.1235, 123.5]
    >>> to_digits(np.array([1000.123456789]), 1000.0, 1001.0, 4)
    [1000.123]

    """
    sizes = np.minimum(np.abs(values), high - low)
    exponents = np.searchsorted(_powers_of_ten(), sizes, side="right") - 1 + _LEAST_EXPONENT
    # By Python, whose `round` is that of the decimal text; that of numpy multiplies by a power of ten.
    rounded = np.array(list(map(round, values.tolist(), (digits - 1 - exponents).tolist())), dtype=float)
    rounded[rounded < low] = low
    rounded[rounded > high] = high
    found: list[float] = rounded.tolist()
    return found


_LEAST_EXPONENT = -324


@cache
def _powers_of_ten() -> Floats:
    """Return the least number whose text with 17 digits has each exponent, from 0 and 1e-323 on, shape (633,)."""
    # By text: a logarithm would differ in its last bit between machines, and so at a power of ten the exponent.
    return np.array([0.0, *map(_power_of_ten, range(_LEAST_EXPONENT + 1, 309))])


def _power_of_ten(exponent: int) -> float:
    power = float(f"1e{exponent}")
    below = f"{power:.16e}".partition("e")[2] != f"{exponent:+03d}"
    return math.nextafter(power, math.inf) if below else power


def frozen(name: DistributionName, keys: Mapping[str, float], low: float, high: float) -> Any | None:
    """Return the frozen distribution of scipy before the truncation; None for the uniform one."""
    if name == "uniform":
        return None
    from scipy import stats  # noqa: PLC0415  (a second of start-up that few commands need)

    match name:
        case "normal":
            return stats.norm(keys["mean"], keys["sd"])
        case "lognormal":
            return stats.lognorm(s=keys["sigma"], scale=keys["median"])
        case "triangular":
            return stats.triang(c=(keys["mode"] - low) / (high - low), loc=low, scale=high - low)
        case "weibull":
            return stats.weibull_min(c=keys["shape"], scale=keys["scale"])
        case _:
            assert_never(name)

"""The scale on which a search models robustness: logarithmic above the median, and in units of the spread.

| symbol | name     | meaning                                            | shape | unit |
|--------|----------|----------------------------------------------------|-------|------|
| y      | `values` | robustness of the tests so far                     | (n,)  | any  |
| m      |          | median of y                                        | ()    | any  |
| s      |          | m - min y                                          | ()    | any  |
| w(y)   |          | y up to m, and m + s ln(1 + (y - m)/s) above it    | (n,)  | any  |
| z      |          | (w(y) - m)/sd w(y)                                 | (n,)  | -    |
| t      |          | (w(0) - m)/sd w(y), the level that is sought        | ()    | -    |

Only the order below the median, and how far it is to 0, matters to a search for a failure. An outlier, or a wide range
of values far above, would otherwise set the scale; a clipped value stays what it is.
"""

import math

import numpy as np

from ..gp.kernels import Floats

LEAST = 1e-12
"""Least spread, relative to the largest value: below it all values count as the same."""


def spread_below(values: Floats) -> float:
    """Return s of the values (n,), which is above 0.

    >>> spread_below(np.array([1.0, 2.0, 1e6]))
    1.0
    """
    middle = float(np.median(values))
    # Where at least half of the values are the least one, there is no spread below the median.
    return max(middle - float(np.min(values)), 1e-3 * abs(middle), LEAST)


def warped(values: Floats) -> tuple[Floats, float]:
    """Return z (n,) and t for the finite values (n,) of at least one test.

    >>> z, t = warped(np.array([1.0, 2.0, 3.0, 1e6]))
    >>> bool(t < z[0] < z[1] < z[2] < z[3] < 3.0)
    True

    """
    # Neither the unit of a robustness nor a huge one may matter: squares of 1e200 would overflow.
    values = values / (float(np.max(np.abs(values))) or 1.0)
    middle = float(np.median(values))
    spread = spread_below(values)
    squeezed = np.where(values > middle, middle + spread * np.log1p(np.maximum(values - middle, 0.0) / spread), values)
    unit = float(np.std(squeezed))
    unit = unit if unit > LEAST else 1.0
    # A median below 0 squeezes the level as it does the values above it.
    level = 0.0 if middle >= 0 else middle + spread * math.log1p(-middle / spread)
    return (squeezed - middle) / unit, (level - middle) / unit

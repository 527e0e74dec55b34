"""Numbers as a person writes them, and ranges around the values of a few rollouts."""

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal

from ..mathematics.gp.kernels import Floats

PARTS = 20
"""Parts into which `alpha` divides the spread of the objective."""


def clip_around(values: Floats) -> tuple[float, float]:
    """Return a clip for robust values (n,): it contains them with a margin, and shows violations.

    >>> import numpy as np
    >>> clip_around(np.array([-3.0, 7.0])), clip_around(np.array([0.35, 0.4]))
    ((-8.0, 10.0), (-0.21, 0.413))
    """
    low, high = covering(values, 0.5, 0.25)
    # Below it a violation is one value like another; half as far as the best value is above 0 shows its size.
    return (low, high) if low < 0 else (rounded(-high / 2, high, ROUND_FLOOR), high)


def covering(values: Floats, below: float, over: float) -> tuple[float, float]:
    """Return a range that contains `values` and, on either side, a share of their spread.

    >>> import numpy as np
    >>> covering(np.array([-3.0, 7.0]), 0.5, 0.25)
    (-8.0, 10.0)
    """
    low, high = float(values.min()), float(values.max())
    spread = (high - low) or abs(low) or 1.0
    return rounded(low - below * spread, spread, ROUND_FLOOR), rounded(high + over * spread, spread, ROUND_CEILING)


def rounded(value: float, scale: float, rounding: str = ROUND_HALF_EVEN) -> float:
    """Return a number as a person writes it, with the places of the first two digits of `scale` > 0.

    >>> rounded(1047.36, 0.9), rounded(2.01, 2.01, ROUND_CEILING), rounded(-27.5, 20.0)
    (1047.36, 2.1, -28.0)
    """
    places = max(scale, 1e-9 * abs(value))
    return float(Decimal(repr(value)).quantize(Decimal(1).scaleb(math.floor(math.log10(places)) - 1), rounding)) + 0.0


def rounded_up(value: float) -> float:
    """Return the next larger number of two digits; 0 stays 0."""
    return rounded(value, value, ROUND_CEILING) if value else 0.0

"""Rounding to the safe side: of bounds outward to multiples of 1e-9, exact on the printed decimals, and of wealth."""

import math
from fractions import Fraction

STEP = 10**9
"""Bounds are whole multiples of 1/STEP."""
ROUND_OFF = 1e-4
"""A hypothesis is rejected only when its wealth exceeds 1/delta by this share. A value costs at most 2e-11 of it in
rounding, so that the rounding of millions of values causes no rejection."""
RICHEST = 1e300
"""Wealth above this is discarded, so that nothing overflows: less wealth keeps a supermartingale one."""


def round_down(x: float) -> float:
    """Return the largest multiple of 1e-9 that is not above `x`; a multiple is returned unchanged.

    Raises:
        ValueError: `x` is not finite.

    >>> round_down(0.1234567899), round_down(0.3)
    (0.123456789, 0.3)

    """
    return floor_to_step(decimal(x))


def round_up(x: float) -> float:
    """Return the smallest multiple of 1e-9 that is not below `x`; a multiple is returned unchanged.

    Raises:
        ValueError: `x` is not finite.

    >>> round_up(0.1234567891), round_up(-0.3)
    (0.12345679, -0.3)

    """
    return -floor_to_step(-decimal(x))


def decimal(x: float) -> Fraction:
    """Return the shortest decimal that names the double `x`, exactly.

    That is the number a reader of the certificate gets, so 0.46 - 0.38 - 0.08 is 0 here and not -4e-17. The nearest
    double of a multiple of 1e-9 prints as that multiple, so rounding leaves it unchanged.

    Raises:
        ValueError: `x` is not finite.

    """
    if not math.isfinite(x):
        raise ValueError(f"a bound needs finite numbers, not {x!r}")
    return Fraction(repr(float(x)))


def floor_to_step(exact: Fraction) -> float:
    """Return the largest multiple of 1/STEP below or at `exact` as a double that, as printed, is not above it."""
    nearest = math.floor(exact * STEP) / STEP
    # Above 2^23 doubles are further apart than 1/STEP, and the nearest one may be too large.
    return nearest if decimal(nearest) <= exact else math.nextafter(nearest, -math.inf)

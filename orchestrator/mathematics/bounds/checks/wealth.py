"""Wealth after many bets that are settled at once; apart, because who bets one by one loads no numerical library."""

import numpy as np

from ...gp.kernels import Floats
from ..rounding import RICHEST


def wealth_after(wealth: Floats, factors: Floats) -> Floats:
    """Return the wealth (k, S) of S strategies after each of k rows of factors, from that before them (S,).

    Each factor is positive; they are multiplied one after the other, so k rows at once give what one by one gives.
    """
    with np.errstate(over="ignore"):
        found: Floats = np.multiply.accumulate(np.vstack([wealth, factors]))[1:]
        if not (found <= RICHEST).all():
            for row, factor in enumerate(factors):
                wealth = found[row] = np.minimum(wealth * factor, RICHEST)
    return found

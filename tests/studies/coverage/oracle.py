"""The judge: when is a statement about a known truth false, and how many false ones may there be? Standard library,
numpy and scipy only.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, binom

Floats = NDArray[np.float64]

ROUNDING = 1e-9
"""Bounds are rounded outward to this; a smaller difference is the arithmetic of the truth."""
LEVEL = 1e-4
"""Frequency at which the rule rejects a row whose failure probability is exactly the claimed one."""


def outside(values: Floats, lower: Floats, upper: Floats) -> bool:
    """Return whether any of `values` is outside [lower, upper]; NaN counts as outside."""
    return not bool(np.all((lower - ROUNDING <= values) & (values <= upper + ROUNDING)))


def allowed(campaigns: int, claimed: float) -> int:
    """Return the largest number of failures that is still no proof, at LEVEL, that they are more than `claimed`.

    A statement that fails with probability at most `claimed` in independent campaigns exceeds it with probability at
    most LEVEL. Where failure is impossible (claimed = 0) none is allowed.

    >>> allowed(1000, 0.1), allowed(1000, 0.0)
    (137, 0)
    """
    return int(binom.isf(LEVEL, campaigns, claimed)) if claimed > 0 else 0


def at_most(failures: int, campaigns: int) -> float:
    """Return the 95 % upper confidence limit of a failure probability (Clopper-Pearson).

    >>> round(at_most(0, 1000), 4)
    0.003
    """
    return 1.0 if failures >= campaigns else float(beta.ppf(0.95, failures + 1, campaigns - failures))

"""A lower bound of the probability of a rare failure, from samples drawn around one failure (importance sampling).

| symbol | name         | meaning                                                                  | shape  | unit |
|--------|--------------|--------------------------------------------------------------------------|--------|------|
| t      | `scores`     | scores of the disturbances: independent standard normal in operation     | (k,)   | sd   |
| c      | `centre`     | scores of the failure around which samples are drawn                     | (k,)   | sd   |
| a      | `DEFENSIVE`  | share of the samples that are drawn as in operation                      | ()     | -    |
| w      |              | density of t in operation over that of t among the samples               | ()     | -    |
| x_i    | `weights`    | w of sample i if it fails, else 0                                        | (n,)   | -    |
| P      |              | probability of a failure in operation; the mean of x_i                   | ()     | -    |
| p      |              | candidate; the null hypothesis is P <= p                                 | ()     | -    |
| u_j    | `STAKES`     | share of the wealth at risk in a sample                                  | (s,)   | -    |
| W      |              | (1/s) sum_j prod_i (1 - u_j + u_j x_i/p)                                 | ()     | -    |
| delta  | `delta`      | failure probability of the bound                                         | ()     | -    |

Samples are drawn from a N(0, I) + (1 - a) N(c, I), so that w = 1/(a + (1 - a) exp(c . t - |c|^2/2)).

Validity. Every x_i is at least 0 with mean P, given the samples before. For P <= p each factor is at least 1 - u_j > 0
with a mean of at most 1: W has a mean of at most 1, and P[W >= 1/delta] <= delta by Markov's inequality. W falls in p,
so the candidates that are rejected are an interval from 0, and its end is the bound. A weight that is too small, such
as 0 for a sample that was not simulated as drawn, makes the bound smaller and never invalid. No upper bound follows: it
would need the largest x_i, and that is known only of samples that were drawn.
"""

import math
from collections.abc import Sequence
from decimal import ROUND_FLOOR, Context

import numpy as np

from ..rounding import ROUND_OFF

DEFENSIVE = 0.1
"""Few are enough: w is at most 1/a, and where a failure elsewhere is likelier these find it."""
STAKES = 0.5 ** np.arange(1.0, 9.0)
"""From bold ones, for some hundred samples that mostly fail, to careful ones, for weights that differ by far."""
DIGITS = 6
"""Significant digits of the bound, rounded down: the last ones of a logarithm depend on the machine."""
PRECISION = 1e-12
"""Of ln p in the search for the end of the interval."""


def importance_weight(scores: Sequence[float], centre: Sequence[float]) -> float:
    """Return w of one sample; at most 1/`DEFENSIVE`.

    >>> round(importance_weight((3.0,), (3.0,)), 6), round(importance_weight((-3.0,), (3.0,)), 6)
    (0.012328, 9.999877)

    """
    exponent = math.fsum(c * t for c, t in zip(centre, scores, strict=True)) - math.fsum(c * c for c in centre) / 2
    # Far beyond the failure w is next to 0, and the exponential overflows.
    return 1.0 / (DEFENSIVE + (1.0 - DEFENSIVE) * math.exp(exponent)) if exponent < 700.0 else 0.0


def weighted_failure_lower(weights: Sequence[float], count: int, delta: float) -> float:
    """Return a lower bound of the probability of a failure, with probability 1 - delta for this number of samples.
    Implements eq. (importance sampling) of [PB].

    Formula: the largest p of `DIGITS` significant digits with W >= 1/delta, a ROUND_OFF above; 0 without a failure.
    `weights` are those of the samples that fail, of `count` samples in all.

    Raises:
        ValueError: a weight is negative or not finite, there are more than samples, or delta is outside (0, 1).

    >>> weighted_failure_lower([1e-5] * 100, 200, 0.05)
    3.91972e-06

    """
    x = np.array(weights, dtype=np.float64)
    if not (np.isfinite(x).all() and (x >= 0.0).all() and len(x) <= count and 0.0 < delta < 1.0):
        raise ValueError(f"needs weights of at least 0 of at most {count} samples, and delta in (0, 1), not {delta}")
    x = x[x > 0.0]
    if not len(x):
        return 0.0
    passed = (count - len(x)) * np.log1p(-STAKES)
    threshold = math.log((1.0 + ROUND_OFF) / delta * len(STAKES))

    def is_rejected(log_p: float) -> bool:
        # In logarithms, for x/p may be beyond all doubles.
        gains = np.logaddexp(np.log1p(-STAKES)[:, None], np.log(STAKES)[:, None] + np.log(x) - log_p)
        return bool(np.logaddexp.reduce(gains.sum(axis=1) + passed) >= threshold)

    # At p = mean of x no product is above 1: the logarithm is concave. As p falls each of them rises without limit.
    high = math.log(math.fsum(x.tolist())) - math.log(count)
    low = high - 1.0
    while not is_rejected(low):
        low, high = low - (high - low), low
    while high - low > PRECISION:
        middle = (low + high) / 2
        low, high = (middle, high) if is_rejected(middle) else (low, middle)
    rounded = Context(prec=DIGITS, rounding=ROUND_FLOOR).create_decimal(repr(math.exp(low)))
    return min(float(rounded), 1.0)

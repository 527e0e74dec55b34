"""Bounds for shares of a distribution, from independent samples whose number is fixed beforehand.

| symbol   | name       | meaning                                                               | shape  | unit |
|----------|------------|-----------------------------------------------------------------------|--------|------|
| n, k     | `count`, `failures` | samples, n fixed beforehand, and failures among them         | ()     | -    |
| P        |            | probability that a sample fails                                       | ()     | -    |
| v_(k)    |            | k-th smallest of n values; large is good                              | (n,)   | v    |
| k        | `rank`     | of a value, 1 .. n                                                    | ()     | -    |
| q        | `share`    | in (0, 1); Q_q = inf{t: P(v <= t) >= q}                               | ()     | -    |
| Lambda   | `ratio`    | dP'/dP <= Lambda for another distribution P'; at least 1              | ()     | -    |
| delta    | `delta`    | failure probability of a bound                                        | ()     | -    |

A missing sample is counted as a failure, or as the least value. Where n depends on outcomes, the bounds of `failures`
and `predictable` are valid and these are not.
"""

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..rounding import decimal, floor_to_step, round_down, round_up


def clopper_pearson_upper(failures: int, count: int, delta: float) -> float:
    """Return an upper bound of the probability of a failure, with probability 1 - delta, rounded up to 1e-9.
    Implements eq. (Clopper-Pearson) of [PB].

    Formula: the largest p with P[Bin(n, p) <= k] >= delta; 1 for k = n. Assumes n independent trials, n fixed
    beforehand, and that a missing trial is counted as a failure.

    Raises:
        ValueError: `failures` is outside [0, count], there is no trial, or delta is outside (0, 1).

    >>> clopper_pearson_upper(0, 299, 0.05), clopper_pearson_upper(3, 3, 0.05)
    (0.009969147, 1.0)

    """
    check_counts(failures, count, delta)
    if failures == count:
        return 1.0
    p = round_up(min(float(scipy.special.betaincinv(failures + 1, count - failures, 1.0 - delta)), 1.0))
    # The quantile function is iterative: the distribution function, with its own round-off, decides.
    while p < 1.0 and not float(scipy.special.bdtr(failures, count, p)) <= delta * (1.0 - 1e-12):
        p = min(round_up(p + 1e-9), 1.0)
    return p


def clopper_pearson_lower(failures: int, count: int, delta: float) -> float:
    """Return a lower bound of the probability of a failure, with probability 1 - delta, rounded down to 1e-9.
    Implements eq. (Clopper-Pearson) of [PB].

    Formula: the least p with P[Bin(n, p) >= k] >= delta; 0 for k = 0. Assumes n independent trials, n fixed beforehand;
    a missing trial is *not* counted as a failure here. Together with the upper bound it fails with the sum of both.

    Raises:
        ValueError: `failures` is outside [0, count], there is no trial, or delta is outside (0, 1).

    >>> clopper_pearson_lower(10, 1000, 0.05), clopper_pearson_lower(0, 3, 0.05)
    (0.00543514, 0.0)

    """
    check_counts(failures, count, delta)
    if failures == 0:
        return 0.0
    p = round_down(max(float(scipy.special.betaincinv(failures, count - failures + 1, delta)), 0.0))
    # As above: the distribution function decides.
    while p > 0.0 and not float(scipy.special.bdtrc(failures - 1, count, p)) <= delta * (1.0 - 1e-12):
        p = max(round_down(p - 1e-9), 0.0)
    return p


def unseen_share(count: int, delta: float) -> float:
    """Return the share of failures that `count` random trials without a failure miss with probability delta.

    Formula: p with (1 - p)^n = delta, the bound of Clopper and Pearson for k = 0, not rounded.

    >>> round(unseen_share(20, 0.05), 3)
    0.139

    """
    return float(1.0 - delta ** (1.0 / count))


def quantile_rank(count: int, share: float, delta: float) -> int | None:
    """Return the k for which the k-th smallest of `count` values is a lower bound of their quantile; None without one.
    Implements eq. (quantile) of [PB].

    Formula: the largest k with P[Bin(n, q) <= k - 1] <= delta. Then P[v_(k) <= Q_q] >= 1 - delta for every law, Q_q =
    inf{t: P(v <= t) >= q}. Assumes n independent values, n fixed beforehand.

    Raises:
        ValueError: there is no value, or `share` or `delta` is outside (0, 1).

    >>> quantile_rank(29, 0.1, 0.05), quantile_rank(28, 0.1, 0.05), quantile_rank(1600, 0.1, 0.05)
    (1, None, 140)

    """
    if count < 1 or not 0.0 < share < 1.0 or not 0.0 < delta < 1.0:
        raise ValueError(f"count must be positive, share and delta in (0, 1); not {count!r}, {share!r}, {delta!r}")
    below = np.asarray(scipy.special.bdtr(np.arange(count), count, share)) <= delta * (1.0 - 1e-12)
    return int(below.sum()) or None


def quantile_lower(values: Iterable[float], share: float, delta: float) -> float | None:
    """Return the value with the rank of `quantile_rank`, rounded down to 1e-9; None where there are too few values.
    Implements eq. (quantile) of [PB].

    Formula, assumptions and errors as of `quantile_rank`.

    >>> quantile_lower([0.1 * k for k in range(29)], 0.1, 0.05)
    0.0

    """
    given = np.fromiter(values, dtype=np.float64)
    rank = quantile_rank(len(given), share, delta)
    return None if rank is None else round_down(ranked(given, rank))


def ranked(values: ArrayLike, rank: int) -> float:
    """Return the `rank`-th smallest of the values, from 1."""
    # Of a million values a twentieth of the time of a sort.
    return float(np.partition(np.asarray(values), rank - 1)[rank - 1])


def next_rollout_probability(rank: int, count: int) -> float:
    """Return the probability with which the next value is not below the `rank`-th smallest of `count`.
    Implements eq. (next rollout) of [PB].

    Formula: P[v_(n+1) >= v_(k)] >= 1 - k/(n + 1), rounded down to 1e-9. The probability is over the n values *and* the
    next one: it is no statement about the share of next values after these n. Assumes that the n + 1 values are
    exchangeable, and n and k fixed beforehand.

    Raises:
        ValueError: `rank` is outside [1, count].

    >>> next_rollout_probability(1, 99), next_rollout_probability(3, 299)
    (0.99, 0.99)

    """
    if not 1 <= rank <= count:
        raise ValueError(f"rank must be in [1, {count}], not {rank}")
    return floor_to_step(1 - Fraction(rank, count + 1))


def next_rollout_rank(count: int, delta: float) -> int | None:
    """Return the largest rank whose value the next one reaches with probability 1 - delta; None without one.
    Implements eq. (next rollout) of [PB].

    Formula: the largest k with k/(n + 1) <= delta. Assumptions as of `next_rollout_probability`.

    Raises:
        ValueError: there is no value, or delta is outside (0, 1).

    >>> next_rollout_rank(99, 0.05), next_rollout_rank(18, 0.05), next_rollout_rank(19, 0.05)
    (5, None, 1)

    """
    check_counts(0, count, delta)
    return math.floor(decimal(delta) * (count + 1)) or None


def shifted_failure_upper(p: float, ratio: float) -> float:
    """Return an upper bound of P'(failure) for every P' with dP'/dP <= `ratio`, rounded up to 1e-9.
    Implements eq. (shift) of [PB].

    Formula: min(1, Lambda p) with p an upper bound of P(failure); valid for every Lambda at once, at the delta of p.
    Assumes that a start fails with the same probability under both: only the starts are shifted.

    Raises:
        ValueError: p is outside [0, 1], or Lambda is below 1 or infinite.

    >>> shifted_failure_upper(0.009969147, 3.0)
    0.029907441

    """
    if not 0.0 <= p <= 1.0:
        raise ValueError(f"p must be in [0, 1], not {p!r}")
    _check_ratio(ratio)
    return min(1.0, -floor_to_step(-decimal(p) * decimal(ratio)))


def shifted_share(ratio: float, share: float = 1.0) -> float:
    """Return the share q/Lambda of P that is below what is below the share q of every P' with dP'/dP <= `ratio`.
    Implements eq. (shift) of [PB].

    Formula: q/Lambda, rounded down to a double, so that a quantile or CVaR at it is not above it; E'[v] >=
    CVaR_(1/Lambda)(v), with equality for the P' that has Lambda times the density on the worst share. Every Lambda is a
    claim of its own.

    Raises:
        ValueError: Lambda is below 1 or infinite.

    >>> shifted_share(1.0), shifted_share(4.0), shifted_share(2.0, 0.1)
    (1.0, 0.25, 0.05)

    """
    _check_ratio(ratio)
    found = share / ratio
    while Fraction(found) * decimal(ratio) > Fraction(share):
        found = math.nextafter(found, 0.0)
    return found


def _check_ratio(ratio: float) -> None:
    if not 1.0 <= ratio < math.inf:
        raise ValueError(f"ratio must be at least 1 and finite, not {ratio!r}")


def check_counts(failures: int, count: int, delta: float) -> None:
    """Check the input of a bound of a probability.

    Raises:
        ValueError: `failures` is outside [0, count], there is no trial, or delta is outside (0, 1).

    """
    if not 0 <= failures <= count or count < 1:
        raise ValueError(f"failures must be in [0, {count}] and count at least 1, not {failures}")
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")

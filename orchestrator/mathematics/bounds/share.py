"""Bounds of shares of a distribution of starts, from starts that are drawn independently from it.

| symbol | name       | meaning                                                          | shape | unit |
|--------|------------|------------------------------------------------------------------|-------|------|
| n, k   | `count`, `failures` | independent trials, fixed beforehand, and failures among them | () | -  |
| p      |            | probability of a failure                                         | ()    | -    |
| delta  | `delta`    | failure probability of the bound                                 | ()    | -    |
"""

from scipy.special import bdtr, betaincinv

from .rounding import round_up


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
    if not 0 <= failures <= count or count < 1:
        raise ValueError(f"failures must be in [0, {count}] and count at least 1, not {failures}")
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")
    if failures == count:
        return 1.0
    p = round_up(min(float(betaincinv(failures + 1, count - failures, 1.0 - delta)), 1.0))
    # The quantile function is iterative: the distribution function, with its own round-off, decides.
    while p < 1.0 and not float(bdtr(failures, count, p)) <= delta * (1.0 - 1e-12):
        p = min(round_up(p + 1e-9), 1.0)
    return p

"""Upper bound of the risk E rho - r sd(rho) of one law, valid for all numbers of rollouts at once.

| symbol  | name          | meaning                                                         | shape | unit |
|---------|---------------|-----------------------------------------------------------------|-------|------|
| rho_i   | `value`       | robustness of the i-th rollout at one start, clipped to [-m, M] | ()    | rho  |
| [-m, M] | `clip`        | M > -m                                                          | (2,)  | rho  |
| r       | `risk_weight` | weight of the standard deviation, r >= 0                        | ()    | -    |
| x_i     |               | (M - rho_i)/(M + m), of mean (M - E rho)/(M + m)                | ()    | -    |
| y_j     |               | ((rho_(2j-1) - rho_2j)/(M + m))^2, of mean 2 var(rho)/(M + m)^2 | ()    | -    |
| a, b    |               | lower bounds of the means of x and y, delta/2 each              | ()    | -    |
| delta   | `delta`       | failure probability of the bound                                | ()    | -    |

Two rollouts of one law have E (rho_1 - rho_2)^2 = 2 var(rho) whatever their mean is, so that pairs need no estimate of
it: the sample variance in their place would be no lower bound of anything. x and y are in [0, 1], and betting bounds
both means from below for all n at once. The pairs follow from the order of the rollouts and not from their values.
"""

import math
from fractions import Fraction

from ..rounding import decimal, floor_to_step, round_down
from .betting import BettingSequence, Past
from .risk import check_risk


class RiskUpperBound:
    """Upper bound of the risk of independent values of one law, running minimum, for all n at once.
    Implements eq. (risk at a start) of [PB].

    Formula: U(E rho) - r sqrt(L(var rho)) with U = M - (M + m) a and L = (M + m)^2 b/2. Assumes fresh values: what
    chose the law depends on none of them, and when the sampling ends may depend on those so far. Values and bounds have
    one unit; all are rounded to the safe side to 1e-9.

    Raises:
        ValueError: the clip is empty or infinite, r is negative or not finite, or delta is outside (0, 1).

    >>> bound = RiskUpperBound((-0.05, 0.75), 0.2, delta=0.05)
    >>> for i in range(100):
    ...     bound.add((0.3, 0.4, 0.5, 0.4)[i * i % 7 % 4])  # mean .385, sd .083
    >>> bound.count, round(bound.mean, 3), round(bound.deviation, 3), round(bound.upper, 3)
    (100, 0.41, 0.077, 0.395)

    """

    def __init__(self, clip: tuple[float, float], risk_weight: float, *, delta: float) -> None:
        check_risk(clip, risk_weight)
        if not 0.0 < delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {delta!r}")
        self._clip, self._risk_weight = clip, risk_weight
        self._mean = _Lower(delta / 2)
        self._squares = _Lower(delta / 2)
        self._single: float | None = None
        self.count = 0
        """Number of values."""

    def add(self, value: float) -> None:
        """Add the next value.

        Raises:
            ValueError: it is outside the clip.

        """
        low, high = self._clip
        if not low <= value <= high:
            raise ValueError(f"a value must be in [{low!r}, {high!r}], not {value!r}")
        self._mean.add((high - value) / (high - low))
        if self._single is None:
            self._single = value
        else:
            # Disjoint pairs: given the past, the square of an overlapping one has another mean, and W no bound.
            self._squares.add(((value - self._single) / (high - low)) ** 2)
            self._single = None
        self.count += 1

    @property
    def mean(self) -> float:
        """Upper bound of the mean."""
        low, high = map(decimal, self._clip)
        return -floor_to_step((high - low) * self._mean.bound - high)

    @property
    def deviation(self) -> float:
        """Lower bound of the standard deviation."""
        low, high = map(decimal, self._clip)
        # A root loses far less than 1e-12 of the range to rounding.
        found = math.sqrt(self._squares.bound / 2) * float(high - low) * (1 - 1e-12)
        return max(round_down(found), 0.0)

    @property
    def upper(self) -> float:
        """Upper bound of the risk."""
        return -floor_to_step(decimal(self._risk_weight) * decimal(self.deviation) - decimal(self.mean))


class _Lower:
    """Lower bound of the mean of values in [0, 1], whose bets follow from the values before."""

    def __init__(self, delta: float) -> None:
        # No imaginary first value: at the end of the range it would make bets on squares, near 0, far too large.
        self._sequence, self._past = BettingSequence((delta,)), Past()

    @property
    def bound(self) -> Fraction:
        """The bound."""
        return Fraction(self._sequence.lower())

    def add(self, x: float) -> None:
        """Add the next value, which leaves [0, 1] by rounding at most."""
        inside = min(max(x, 0.0), 1.0)
        self._sequence.observe(inside, self._past)
        self._past.add(inside)

"""Test of the opposite of a claim: do rollouts show that some start is worse than a limit?

| symbol   | name      | meaning                                                                    | shape | unit |
|----------|-----------|----------------------------------------------------------------------------|-------|------|
| x_t      | `value`   | t-th value, in [low, high]                                                  | ()    | v    |
| u        | `limit`   | the hypothesis: the mean of x_t given the past is at least u, for every t   | ()    | v    |
| lambda_s |           | bet of strategy s on u - x_t, from the values before it alone               | ()    | 1/v  |
| W        | `wealth`  | mean over s of prod_t (1 + lambda_s (u - x_t))                              | ()    | -    |
| delta    |           | failure probability                                                         | ()    | -    |

With 0 <= lambda_s <= CAP/(high - u) every factor is positive and has a mean of at most 1 under the hypothesis, whatever
rule chose the start of x_t from the past. So W is a positive supermartingale that starts at 1, and by Ville it reaches
1/delta with probability at most delta. Then some start has a mean below u, whichever it is: a hypothesis about every
start needs no union over them. Two strategies bet what the values at the same start suggest (Kelly, second order), the
second for a deficit that is a standard error smaller, so that many starts at the limit cost little; the third bets a
fixed part of the largest bet, for a system that is bad everywhere.
"""

import math
from collections.abc import Hashable
from dataclasses import dataclass, field

from ..rounding import RICHEST, ROUND_OFF

CAP = 0.95
"""Largest share of the wealth that one value may cost."""
PART = 0.1
"""The fixed bet, as a part of the largest one."""


@dataclass(slots=True)
class _Past:
    count: int = 0
    total: float = 0.0
    squares: float = 0.0

    def suggested(self, caution: float) -> float:
        """Return the best bet for a mean so many standard errors below that of these deficits; 0 for none."""
        if not self.squares > 0.0:
            return 0.0
        mean, square = self.total / self.count, self.squares / self.count
        error = math.sqrt(max(square - mean * mean, 0.0) / self.count)
        return max(0.0, (mean - caution * error) / square)

    def add(self, deficit: float) -> None:
        self.count += 1
        self.total += deficit
        self.squares += deficit * deficit


@dataclass(slots=True)
class OppositeTest:
    """Test of the hypothesis that the mean at every start is at least `limit`, by betting against it.

    Implements eq. (capital process) of [WSR], with bets that depend on the start.
    Assumes that the mean of a value given the past is the one at its start. Values and limit have one unit.

    Raises:
        ValueError: the range is empty or infinite, or the limit is outside of it.

    >>> test = OppositeTest(0.0, -1.0, 1.0)
    >>> for _ in range(20):
    ...     test.observe("a start", -0.5)
    >>> test.wealth > 20
    True

    """

    limit: float
    low: float
    high: float
    _wealth: list[float] = field(default_factory=lambda: [1.0] * 3)
    _starts: dict[Hashable, _Past] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the range."""
        if not (math.isfinite(self.high - self.low) and self.low <= self.limit < self.high):
            raise ValueError(f"the limit {self.limit!r} must be in [{self.low!r}, {self.high!r}), both finite")

    @property
    def wealth(self) -> float:
        """W, at first 1."""
        return math.fsum(self._wealth) / len(self._wealth)

    def refutes(self, delta: float) -> bool:
        """Whether the values refute the hypothesis with confidence 1 - delta."""
        return self.wealth >= (1.0 + ROUND_OFF) / delta

    def observe(self, start: Hashable, value: float) -> None:
        """Add the next value.

        Raises:
            ValueError: it is outside of the range.

        """
        if not self.low <= value <= self.high:
            raise ValueError(f"a value must be in [{self.low!r}, {self.high!r}], not {value!r}")
        past, deficit = self._starts.setdefault(start, _Past()), self.limit - value
        largest = CAP / (self.high - self.limit)
        bets = (min(past.suggested(0.0), largest), min(past.suggested(1.0), largest), PART * largest)
        for number, bet in enumerate(bets):
            self._wealth[number] = min(self._wealth[number] * (1.0 + bet * deficit), RICHEST)
        past.add(deficit)

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
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..rounding import RICHEST, ROUND_OFF

# Imported where many values come at once: `status` loads no numerical library.
if TYPE_CHECKING:
    from ...gp.kernels import Floats

CAP = 0.95
"""Largest share of the wealth that one value may cost."""
PART = 0.1
"""The fixed bet, as a part of the largest one."""
ALONE = 32
"""Values up to which arrays take longer than numbers."""
AT_ONCE = 4096
"""Values that are taken at once, so that memory does not grow with their number."""


@dataclass(slots=True)
class _Past:
    count: int = 0
    total: float = 0.0
    squares: float = 0.0

    def suggested(self, caution: float) -> float:
        """Return the best bet for a mean so many standard errors below that of these deficits; 0 for none."""
        if not self.squares > 0.0 or not (square := self.squares / self.count) > 0.0:
            return 0.0  # also where squares are too small for a double
        mean = self.total / self.count
        error = math.sqrt(max(square - mean * mean, 0.0) / self.count)
        return max(0.0, (mean - caution * error) / square)

    def add(self, deficit: float) -> None:
        self.count += 1
        self.total += deficit
        self.squares += deficit * deficit

    def add_each(self, deficits: "Floats") -> "tuple[Floats, Floats]":
        """Add deficits (k,); return what `suggested` gives before each (k,), without caution and with 1."""
        import numpy as np  # noqa: PLC0415

        counts = self.count + np.arange(len(deficits) + 1)
        with np.errstate(all="ignore"):
            totals = np.add.accumulate(np.concatenate([[self.total], deficits]))
            squares = np.add.accumulate(np.concatenate([[self.squares], deficits * deficits]))
            mean, square = (sums[:-1] / counts[:-1] for sums in (totals, squares))
            error = np.sqrt(np.maximum(square - mean * mean, 0.0) / counts[:-1])
            bets = [np.where(square > 0.0, np.fmax(0.0, best / square), 0.0) for best in (mean, mean - error)]
        self.count, self.total, self.squares = int(counts[-1]), float(totals[-1]), float(squares[-1])
        return bets[0], bets[1]


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

    def observe_each(self, start: Hashable, each: Sequence[float]) -> None:
        """Add the next values (k,), all at one start; the result is the same in whatever pieces.

        Raises:
            ValueError: one is outside of the range; then none is added.

        """
        outside = [value for value in each if not self.low <= value <= self.high]
        if outside:
            raise ValueError(f"a value must be in [{self.low!r}, {self.high!r}], not {float(outside[0])!r}")
        if len(each) <= ALONE:
            for value in each:
                self.observe(start, value)
            return
        import numpy as np  # noqa: PLC0415

        from .wealth import wealth_after  # noqa: PLC0415

        values = np.array(each, dtype=np.float64)
        largest = CAP / (self.high - self.limit)
        for first in range(0, len(values), AT_ONCE):
            deficits = self.limit - values[first : first + AT_ONCE]
            suggested = self._starts.setdefault(start, _Past()).add_each(deficits)
            bets = [*np.minimum(suggested, largest), np.full(len(deficits), PART * largest)]
            factors = 1.0 + np.stack(bets, axis=1) * deficits[:, None]
            self._wealth = wealth_after(np.array(self._wealth), factors)[-1].tolist()

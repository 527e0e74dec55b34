"""Which way of choosing a start comes next: each has a share of the tests, which grows with what it has found lately.

| symbol | name     | meaning                                                                           | shape | unit |
|--------|----------|-----------------------------------------------------------------------------------|-------|------|
| g      | `gain`   | share of the way from the lowest robustness so far to 0 that a test goes          | ()    | -    |
| n_a    | `_tests` | tests of arm a; each counts `MEMORY` of what it did a test ago                    | ()    | -    |
| s_a    | `_gains` | sum of g over them, counted alike                                                 | ()    | -    |
| m_a    |          | `EXPECTED` gain of the arm, as if seen in `PRIOR` tests                           | ()    | -    |
| v_a    |          | (`PRIOR` m_a + s_a)/(`PRIOR` + n_a)                                               | ()    | -    |

Arm a is drawn with probability v_a/sum v. While the models lead downwards they have nearly all tests. One that finds
nothing falls back to those that were hardly tried, and none falls to 0: a search that is stuck continues elsewhere.
"""

from enum import Enum

import numpy as np


class Arm(Enum):
    """A way of choosing a start."""

    LIKELY = "likely"
    """Where a failure is likeliest by the models of the parts."""
    WHOLE = "whole"
    """Where it is likeliest by the model of the whole: of a goal with several parts."""
    LOWER = "lower"
    """Where the whole is expected to be lower than ever."""
    SHAPED = "shaped"
    """By no model: parameters at their ends, inputs that stay where they are."""
    ANYWHERE = "anywhere"
    """By no model: of a Sobol sequence."""


EXPECTED = {Arm.LIKELY: 0.1, Arm.WHOLE: 0.1, Arm.LOWER: 0.05, Arm.SHAPED: 0.01, Arm.ANYWHERE: 0.01}
PRIOR, MEMORY = 3.0, 0.97


class Portfolio:
    """The arms of a search and what each has found; not thread-safe.

    The arm of a test is a function of the seed, of its number and of what was observed.

    >>> arms = Portfolio([1], parts=1)
    >>> before = arms.share(Arm.SHAPED)
    >>> for _ in range(40):
    ...     arms.observe(Arm.LIKELY, gain=0.0)
    >>> before < 0.1 < arms.share(Arm.SHAPED)
    True

    """

    def __init__(self, seed: list[int], parts: int) -> None:
        self._seed = seed
        self._arms = [arm for arm in Arm if arm is not Arm.WHOLE or parts > 1]
        self._tests, self._gains = dict.fromkeys(self._arms, 0.0), dict.fromkeys(self._arms, 0.0)

    def arm(self, test: int) -> Arm:
        """Return the arm of a test."""
        left = float(np.random.default_rng([*self._seed, test]).random())
        for arm in self._arms:
            left -= self.share(arm)
            if left < 0.0:
                return arm
        # The sum of the shares may round to a little less than 1.
        return Arm.ANYWHERE

    def share(self, arm: Arm) -> float:
        """Return the probability that the next test is one of an arm."""
        return self._value(arm) / sum(map(self._value, self._arms))

    def observe(self, arm: Arm, gain: float) -> None:
        """Take a test of an arm."""
        for counts in (self._tests, self._gains):
            for each in self._arms:
                counts[each] *= MEMORY
        self._tests[arm] += 1.0
        self._gains[arm] += gain

    def _value(self, arm: Arm) -> float:
        return (PRIOR * EXPECTED[arm] + self._gains[arm]) / (PRIOR + self._tests[arm])


def gain(lowest: float, value: float) -> float:
    """Return which share of the way from the lowest robustness so far to 0 a test went, from 0 to 1.

    >>> gain(2.0, 1.5), gain(2.0, 3.0), gain(2.0, -1.0), gain(-1.0, -2.0)
    (0.25, 0.0, 1.0, 1.0)
    """
    if value >= lowest:
        return 0.0
    return 1.0 - value / lowest if value > 0.0 else 1.0

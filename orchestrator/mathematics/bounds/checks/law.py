"""Test that numbers which come one by one have the law that is declared of them.

| symbol   | name     | meaning                                                                        | shape | unit |
|----------|----------|--------------------------------------------------------------------------------|-------|------|
| u        | `shares` | declared distribution function at each number; at an atom a share of its step  | (n,k) | -    |
| P_j      |          | Legendre polynomial of degree j, at 2 u - 1, in [-1, 1]                        |       | -    |
| lambda_s |          | bet of strategy s, fixed beforehand                                            | (S,)  | -    |
| W        | `wealth` | mean over j and s of prod (1 + lambda_s P_j(2 u - 1)), of one kind of numbers  | ()    | -    |
| W*       | `peak`   | largest W so far                                                               | ()    | -    |
| alpha    | `level`  | probability of a false alarm, over all kinds and times at once                 | ()    | -    |

Null hypothesis: given those before it, each u is uniform. Then E P_j = 0 for each j >= 1, W is a martingale, and by
Ville P[W* >= k/alpha] <= alpha/k, however long the numbers come. The degrees 1 to 4 see a shift, a scale, a skewness
and heavy tails. A number that the law does not have refutes it at once.

Power, of a normal law: half of the campaigns see a scale that is wrong by 10 % after about 1,000 numbers, by 20 % after
350, by a factor of 2 after 35; and a mean that is off by 0.3 standard deviations after 210.
"""

import numpy as np

from ...gp.kernels import Floats
from ..rounding import RICHEST, ROUND_OFF
from .audit import Finding, Status
from .stationarity import LEVEL
from .wealth import wealth_after

DEGREES = 4
SLOPES = (0.1, 0.3, 0.9)
"""Bets on each polynomial: plus and minus these."""
UNSEEN = 330.0
"""Percent, of 1 number: 10 % of 1,100."""
AT_ONCE = 2**12
"""Numbers that are settled together: every division into such pieces gives the same wealth."""
_BETS = np.tile([*SLOPES, *(-slope for slope in SLOPES)], DEGREES)  # (S,)


class LawTest:
    """The test of k kinds of numbers, each against its law.
    Implements eq. (law) of [PB].

    >>> test = LawTest(1)
    >>> test.observe(np.full((40, 1), 0.5))
    >>> test.finding().status
    'refuted'

    """

    def __init__(self, kinds: int, *, level: float = LEVEL) -> None:
        self._level, self.count = level, 0
        self._wealth = np.full((kinds, len(_BETS)), 1.0 / len(_BETS))
        self._peaks, self._impossible = np.ones(kinds), np.zeros(kinds, dtype=np.int64)

    def observe(self, shares: Floats) -> None:
        """Take the next shares (n, k); NaN of a number that its law does not have."""
        self.count += len(shares)
        impossible = np.isnan(shares)
        self._impossible += impossible.sum(axis=0)
        self._peaks[impossible.any(axis=0)] = RICHEST
        for kind, column in enumerate(np.where(impossible, 0.5, shares).T):
            for first in range(0, len(column), AT_ONCE):
                factors = 1.0 + np.repeat(_legendre(column[first : first + AT_ONCE]), 2 * len(SLOPES), axis=1) * _BETS
                each = wealth_after(self._wealth[kind], factors)
                self._wealth[kind] = each[-1]
                self._peaks[kind] = max(self._peaks[kind], float(each.sum(axis=1).max()))

    def finding(self) -> Finding:
        """Return whether a law is refuted; `assumed` while there is no number.

        `e_value` is the largest W*/k, `kind` the place of the one that has it, `threshold` 1/level. Of this one as many
        numbers are `impossible`. `unseen` is an error of a scale, in percent, of which so many numbers are about as
        likely to show nothing as to refute it.
        """
        values: dict[str, int | float | str] = {"values": self.count, "threshold": 1.0 / self._level}
        values |= {"level": self._level}
        if not self.count:
            return Finding("assumed", values)
        kind = int(np.argmax(self._peaks))
        evidence = float(self._peaks[kind]) / len(self._peaks)
        status: Status = "refuted" if evidence >= (1.0 + ROUND_OFF) / self._level else "not refuted"
        # Three digits: the evidence is a size, and no claim is made of its last digits.
        found = {"e_value": float(f"{evidence:.3g}"), "kind": kind, "impossible": int(self._impossible[kind])}
        return Finding(status, {**found, "unseen": float(f"{UNSEEN / self.count**0.5:.2g}"), **values})


def _legendre(shares: Floats) -> Floats:
    """Return P_1 .. P_4 (n, 4) of shares (n,)."""
    x = 2.0 * shares - 1.0
    square = x * x
    return np.column_stack(
        [x, (3.0 * square - 1.0) / 2.0, x * (5.0 * square - 3.0) / 2.0, (square * (35.0 * square - 30.0) + 3.0) / 8.0]
    )

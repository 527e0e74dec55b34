"""Which of many counts reject a candidate, by the wealth at few of them.

| symbol | name       | meaning                                                          | shape | unit |
|--------|------------|------------------------------------------------------------------|-------|------|
| k_i    | `failures` | failures among the first n_i samples; neither of the two falls   | (t,)  | -    |
| n_i    | `counts`   |                                                                  | (t,)  | -    |
| p      |            | candidate, at most P or at least P by the null hypothesis        | ()    | -    |
| W      | `wealth`   | wealth of the bets against the null hypothesis of p              | ()    | -    |
| s      | `slope`    | k/n along which W is about the same                              | ()    | -    |
| d      | `offset`   | min_i (k_i - s n_i), or the maximum                              | ()    | -    |

The logarithms of what `failures` bets are linear in k and n, so ln W, of their mean, is convex in (k, n). Against
P >= p it falls in k. So no ln W is above the larger one of the two at k = d + s n, where n is the least and the largest
n_i. Against P <= p it rises in k, and d is the maximum. Below the threshold by MARGIN, far more than the functions
lose to rounding, none of the counts rejects p. All others are divided and, one by one, decided by their own wealth:
what is found is what a look at every count finds.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..rounding import STEP

Integers = NDArray[np.int64]

MARGIN = 1e-5
"""Of ln W: a tenth of ROUND_OFF, which is far above the errors of the functions."""
FEW = 2
"""Counts that are decided one by one: as many as evaluations for them all."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Counts (k_i, n_i) in their order."""

    failures: Integers
    counts: Integers

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, part: slice) -> "Counts":
        return Counts(self.failures[part], self.counts[part])

    def pairs(self) -> Iterator[tuple[int, int]]:
        """Yield each k_i with its n_i."""
        yield from zip(self.failures.tolist(), self.counts.tolist(), strict=True)


@dataclass(frozen=True, slots=True)
class Side:
    """The bets against P >= p, whose wealth `falls` in k, or those against P <= p.

    `wealth` returns ln W from p, k and n; k need not be a whole number, but is at least 1 where W rises in it.
    """

    wealth: Callable[[float, float, int], float]
    falls: bool

    def first(self, p: float, among: Counts, threshold: float) -> int | None:
        """Return the place of the first counts that reject p, by their ln W; None without any."""
        waiting = [(0, len(among))]
        while waiting:
            begin, end = waiting.pop()
            part = among[begin:end]
            if len(part) <= FEW:
                for place, (failures, count) in enumerate(part.pairs(), begin):
                    if self.wealth(p, failures, count) >= threshold:
                        return place
            elif self._likeliest(p, part, threshold) is not None:
                middle = (begin + end) // 2
                waiting += [(middle, end), (begin, middle)]
        return None

    def best(self, bound: int, among: Counts, threshold: float, tighten: Callable[[int, int, int], int]) -> int:
        """Return the bound, in steps of 1/STEP, after all counts; `tighten` returns it from k, n and the bound before.

        W rises or falls from step to step by more than rounding errors, so the order of the counts is of no importance.
        """
        waiting = [among]
        while waiting:
            part = waiting.pop()
            # The next candidate to be rejected: while it is not, the bound stays.
            p = (bound - 1 if self.falls else bound + 1) / STEP
            if not 0.0 < p < 1.0:
                return bound
            if len(part) <= FEW:
                for failures, count in part.pairs():
                    bound = tighten(failures, count, bound)
            elif (place := self._likeliest(p, part, threshold)) is not None:
                # What it finds spares most of the others. Halves, not the parts beside the place: those may be many.
                bound, middle = tighten(int(part.failures[place]), int(part.counts[place]), bound), len(part) // 2
                waiting += [part[middle:], part[:middle]]
        return bound

    def _likeliest(self, p: float, among: Counts, threshold: float) -> int | None:
        """Return the place of the counts that most likely reject p; None if surely none of them does."""
        k, n, middle = among.failures, among.counts, len(among) // 2
        slope = 0.5 * (p + float(k[middle]) / max(float(n[middle]), 1.0))
        offsets = k - slope * n
        place = int(offsets.argmin() if self.falls else offsets.argmax())
        offset, first, last = float(offsets[place]), int(n[0]), int(n[-1])
        begin, end, least = offset + slope * first, offset + slope * last, 0.0 if self.falls else 1.0
        ends: tuple[tuple[float, int], ...] = ((begin, first), (end, last))
        if not (least <= begin <= first and least <= end <= last):
            # There are no such counts. W is largest for the fewest failures and the most successes, or the opposite.
            ends = ((float(k[0]), last),) if self.falls else ((float(k[-1]), max(first, int(k[-1]))),)
        for failures, count in ends:
            if not self.wealth(p, failures, count) < threshold - MARGIN:
                return place
        return None

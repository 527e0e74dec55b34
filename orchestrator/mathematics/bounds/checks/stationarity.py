"""Tests that the rollouts of a start have one law during the campaign: ranks of later values among earlier ones.

| symbol   | name     | meaning                                                                   | shape | unit |
|----------|----------|---------------------------------------------------------------------------|-------|------|
| v_n      | `value`  | n-th value of a start, in test order; any unit, bounded or not            | ()    |      |
| u_n      | `place`  | (rank of v_n among v_1 .. v_n - 1/2)/n, ties ranked at random             | ()    | -    |
| lambda_s |          | bet of strategy s, fixed beforehand: a function of n, or of planned times | (S,)  | -    |
| W        | `wealth` | mean over s of prod (1 + lambda_s (2 u_n - 1))                            | ()    | -    |
| W*       | `peak`   | largest W so far                                                          | ()    | -    |
| w_k      |          | share of the level for the k-th start that enters; sum at most 1          | ()    | -    |
| alpha    | `level`  | probability of a false alarm, over all starts and times at once           | ()    | -    |

Null hypothesis: every rollout of a start is an independent draw from one law of that start. Then the u_n of a start
are independent of each other, with mean 1/2, whatever its law (conformal ranks). A drift makes later ranks high, or
low. A change that comes and goes within the campaign can pass.

A campaign returns to a start *because of* its values, and a value that was low by chance is followed by higher ones. No
permutation of the observed values, and no product over starts, is valid then. `AdaptiveOrderTest` is valid for every
rule that chooses tests from the past: the values v_1, v_2, ... of a start may as well lie ready in a column before the
campaign. W of the column is a martingale of its ranks alone, and by Ville P[sup over all n of W >= 1/(w alpha)] <= w
alpha, however much of the column the campaign then uncovers. A union over the starts costs w_k.

`PlannedOrderTest` multiplies the evidence of all starts, which needs far fewer rollouts. It is valid for rollouts whose
starts and order were fixed before the campaign, stopped at any time: a fixed schedule, or an opening and a closing
round, with any other rollouts between them.
"""

import math
from collections.abc import Hashable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...gp.kernels import Floats
from ..rounding import RICHEST, ROUND_OFF
from .audit import Finding, Status
from .wealth import wealth_after

LEVEL = 0.01
CAP = 0.95
"""Largest share of the wealth that one value may cost."""
SLOPES = (0.15, 0.5)
RAMPS = (50, 400)
"""Bets on one start: +-slope * min(1, n/ramp). A drift over N values shifts v_n by about n/N of it."""
LAG_SLOPES = (0.4, 0.9, 1.8)
"""Bets on planned times: +-slope * lag; for a drift by d standard deviations during the plan 1.7 d is best."""
SUMMED = 1e-14
"""Sums of the wealth of a few strategies that differ by a larger share are in the order of the exact sums."""
RECENT = 8192
"""Values of a start that are moved for a new one, at most; more of them join the old ones."""
AT_ONCE = 1024
"""Values that are ranked at once; a count of them fits two bytes."""
PIECE = 128
"""Those of them that are compared with each other; a count of them fits a byte."""
_EARLIER = np.tri(PIECE, k=-1, dtype=np.bool_)


class AdaptiveOrderTest:
    """Test of one law per start for tests that are chosen by past values; one martingale for each start.
    Implements eq. (one law) of [PB].

    `starts` is the number of starts that can occur, fixed beforehand, such as the length of a list: each has the share
    1/starts of the level. Without it a start enters at its second test, and the k-th to enter has 1/(k (k + 1)); the
    values of its first test are discarded, because they decided that it returns.
    Power: N values of one start that drift steadily by d standard deviations are caught with N d^2 above about 450.

    Raises:
        ValueError: the level is outside (0, 1), or `starts` is not positive.

    >>> test = AdaptiveOrderTest(starts=1)
    >>> for n in range(60):
    ...     test.observe(0, n, float(n))
    >>> test.finding().status
    'refuted'

    """

    def __init__(self, *, level: float = LEVEL, starts: int | None = None) -> None:
        _check_level(level)
        if starts is not None and starts < 1:
            raise ValueError(f"starts must be positive, not {starts!r}")
        self._level, self._starts = level, starts
        self._first_test: dict[Hashable, int] = {}
        self._columns: dict[Hashable, _Column] = {}
        self._ties = np.random.default_rng(0)  # independent of the values: any fixed sequence is

    def observe(self, start: Hashable, test: int, value: float) -> None:
        """Add a value of `start` in test order; the replicates of one test have its number.

        Raises:
            ValueError: the value is not a number.

        """
        _check_numbers(value)
        if self._starts is None and self._first_test.setdefault(start, test) == test:
            return
        column = self._column(start)
        column.add(column.ranks.place(value, self._ties))

    def observe_each(self, start: Hashable, tests: NDArray[np.integer], values: Floats) -> None:
        """Add values (k,) of `start` in test order, of the tests (k,); the result is the same in whatever pieces.

        Raises:
            ValueError: a value is not a number; then none is added.

        """
        _check_numbers(*values[~np.isfinite(values)].tolist())
        if self._starts is None and len(tests):
            values = values[tests != self._first_test.setdefault(start, int(tests[0]))]
        if not len(values):
            return
        column = self._column(start)
        for first in range(0, len(values), AT_ONCE):
            column.add_each(column.ranks.places(values[first : first + AT_ONCE], self._ties))

    def finding(self) -> Finding:
        """Return whether one law is refuted; `assumed` while no start has two values.

        `e_value` is the largest w_k W*, `start` its number in the order of entry, `threshold` 1/level.
        """
        columns = list(self._columns.values())
        evidence = [self._share(k) * column.peak for k, column in enumerate(columns, 1)]
        largest = max(range(len(columns)), key=evidence.__getitem__, default=None)
        values = {"starts": len(columns), "values": sum(column.ranks.count for column in columns)}
        if largest is None or values["values"] == len(columns):
            return _finding("assumed", 0.0, self._level, values)
        status: Status = "refuted" if evidence[largest] >= (1.0 + ROUND_OFF) / self._level else "not refuted"
        return _finding(status, evidence[largest], self._level, {**values, "start": largest})

    def _column(self, start: Hashable) -> "_Column":
        if start not in self._columns:
            self._columns[start] = _Column()
        return self._columns[start]

    def _share(self, k: int) -> float:
        # Starts beyond the number that was fixed beforehand have no share left.
        if self._starts is not None:
            return 1.0 / self._starts if k <= self._starts else 0.0
        return 1.0 / (k * (k + 1.0))


class PlannedOrderTest:
    """Test of one law per start for rollouts whose starts and order were fixed before the campaign.
    Implements eq. (one law) of [PB].

    `plan` has the start and the time of every planned rollout, in order. Times have any unit, such as the test number
    that was expected; they decide bets alone. The bets grow with the time since the earlier values of the start.
    Power: a steady drift by d standard deviations is caught by N rollouts with N d^2 above about 250 if they visit the
    starts in turn, and above about 110 if half of them open and the other half close the campaign.

    Raises:
        ValueError: the level is outside (0, 1), the plan is empty, or its times decrease or are not finite.

    >>> test = PlannedOrderTest([(j, 0.0) for j in range(20)] + [(j, 1.0) for j in range(20)])
    >>> for v in [0.0] * 20 + [1.0] * 20:
    ...     test.observe(v)
    >>> test.finding().status
    'refuted'

    """

    def __init__(self, plan: Sequence[tuple[Hashable, float]], *, level: float = LEVEL) -> None:
        _check_level(level)
        self._plan, self._level = list(plan), level
        self._bets = _planned_bets(self._plan)  # (N, S)
        self._ranks: dict[Hashable, _Ranks] = {}
        self._evidence = _Wealth(self._bets.shape[1])
        self._count = 0
        self._ties = np.random.default_rng(0)

    def observe(self, value: float) -> None:
        """Add the value of the next planned rollout.

        Raises:
            ValueError: the value is not a number, or the plan has ended.

        """
        _check_numbers(value)
        if self._count == len(self._plan):
            raise ValueError(f"the plan has {len(self._plan)} rollouts, and all of them have a value")
        ranks = self._ranks.setdefault(self._plan[self._count][0], _Ranks())
        place = ranks.place(value, self._ties)
        self._evidence.multiply(self._bets[self._count], place)
        self._count += 1

    def finding(self) -> Finding:
        """Return whether one law is refuted; `assumed` while no start has two values. `e_value` is W*."""
        values = {"starts": len(self._ranks), "values": self._count}
        if self._count == len(self._ranks):
            return _finding("assumed", 0.0, self._level, values)
        status: Status = "refuted" if self._evidence.peak >= (1.0 + ROUND_OFF) / self._level else "not refuted"
        return _finding(status, self._evidence.peak, self._level, values)


class _Ranks:
    """The values of one start, old and recent ones each in increasing order: a new value moves recent ones alone."""

    def __init__(self) -> None:
        self._old, self._recent = np.empty(0), np.empty(0)

    @property
    def count(self) -> int:
        """Number of values."""
        return len(self._old) + len(self._recent)

    def place(self, value: float, ties: np.random.Generator) -> float:
        """Add a value and return u_n, in (0, 1)."""
        at = int(self._recent.searchsorted(value))
        left = at + int(self._old.searchsorted(value))
        right = int(self._recent.searchsorted(value, "right")) + int(self._old.searchsorted(value, "right"))
        # Values at an end of a clip are often equal. Middle ranks have mean 1/2, too, but are not independent.
        rank = left + (int(ties.integers(right - left + 1)) if right > left else 0)
        self._recent = np.concatenate([self._recent[:at], [value], self._recent[at:]])
        self._age()
        return (rank + 0.5) / self.count

    def places(self, values: Floats, ties: np.random.Generator) -> Floats:
        """Add values (k,) and return their u_n (k,), which are those that `place` returns for each."""
        order = values.argsort(kind="stable")
        ordered, back = values[order], order.argsort()
        # A stable order has equal values in the order of their arrival.
        right = _smaller_before(back)
        left = right - (np.arange(len(values)) - ordered.searchsorted(ordered))[back]
        for known in (self._old, self._recent):
            left += known.searchsorted(ordered)[back]
            right += known.searchsorted(ordered, "right")[back]
        ranks = left + ties.integers(right - left + 1)  # one without ties draws nothing, as in `place`
        places: Floats = (ranks + 0.5) / (self.count + np.arange(1, len(values) + 1))
        self._recent = np.insert(self._recent, self._recent.searchsorted(ordered), ordered)
        self._age()
        return places

    def _age(self) -> None:
        if len(self._recent) > RECENT:
            self._old = np.insert(self._old, self._old.searchsorted(self._recent), self._recent)
            self._recent = np.empty(0)


def _smaller_before(order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return how many smaller numbers precede each of 0 .. k - 1, which are in any order."""
    piece = np.arange(len(order)) // PIECE
    seen = np.zeros((piece[-1] + 2, len(order)), dtype=np.int16)
    seen[piece + 1, order] = 1
    below = seen.cumsum(axis=0, dtype=np.int16).cumsum(axis=1, dtype=np.int16)  # in the pieces before
    found: NDArray[np.intp] = below[piece, order].astype(np.intp)
    for first in range(0, len(order), PIECE):
        own = order[first : first + PIECE].astype(np.int16)
        earlier = _EARLIER[: len(own), : len(own)]
        found[first : first + PIECE] += ((own < own[:, None]) & earlier).sum(axis=1, dtype=np.uint8)
    return found


class _Wealth:
    """Wealth of several strategies with equal shares."""

    def __init__(self, strategies: int) -> None:
        self._each = np.full(strategies, 1.0 / strategies)  # (S,)
        self.peak = 1.0

    def multiply(self, bets: Floats, place: float) -> None:
        """Settle the bets (S,) on one u_n."""
        np.minimum(self._each * (1.0 + bets * (2.0 * place - 1.0)), RICHEST, out=self._each)
        self.peak = max(self.peak, math.fsum(self._each))

    def multiply_each(self, bets: Floats, places: Floats) -> None:
        """Settle the bets (k, S) on u_n (k,), one after the other."""
        each = wealth_after(self._each, 1.0 + bets * (2.0 * places - 1.0)[:, None])
        # The exact sum decides; only rows whose sum is the largest but for rounding can have the largest one.
        sums = each.sum(axis=1)
        rows = each[sums >= max(self.peak, sums.max()) * (1.0 - SUMMED)]
        self._each, self.peak = each[-1].copy(), max([self.peak, *map(math.fsum, rows)])


class _Column:
    """Ranks and wealth of one start; the bets depend on the number of its values alone."""

    def __init__(self) -> None:
        self.ranks = _Ranks()
        self._wealth = _Wealth(_BETS.shape[1])

    @property
    def peak(self) -> float:
        """Largest wealth so far."""
        return self._wealth.peak

    def add(self, place: float) -> None:
        """Bet on the place of the newest value."""
        self._wealth.multiply(_BETS[min(self.ranks.count, len(_BETS)) - 1], place)

    def add_each(self, places: Floats) -> None:
        """Bet on the places (k,) of the newest values."""
        counts = self.ranks.count - np.arange(len(places))[::-1]
        self._wealth.multiply_each(_BETS[np.minimum(counts, len(_BETS)) - 1], places)


def _ramped_bets() -> Floats:
    """Return the bets (N, S) on the n-th value of a start; those after the longest ramp equal the last."""
    counts = np.arange(1, max(RAMPS) + 1)
    bets = [slope * np.minimum(1.0, counts / ramp) for slope in SLOPES for ramp in RAMPS]
    return np.stack([*bets, *(-bet for bet in bets)], axis=1)


_BETS = _ramped_bets()


def _planned_bets(plan: Sequence[tuple[Hashable, float]]) -> Floats:
    """Return the bets (N, S), +-slope * lag: the time since the mean earlier time of the start, as a share of all."""
    times = [time for _, time in plan]
    if not times or not all(map(math.isfinite, times)) or any(b < a for a, b in pairwise(times)):
        raise ValueError("a plan needs at least one rollout, and finite times that do not decrease")
    whole = times[-1] - times[0] or 1.0
    past: dict[Hashable, tuple[int, float]] = {}
    lags = []
    for start, time in plan:
        count, total = past.get(start, (0, 0.0))
        lags.append((time - total / count) / whole if count else 0.0)
        past[start] = (count + 1, total + time)
    slopes = np.array([*LAG_SLOPES, *(-slope for slope in LAG_SLOPES)])
    return np.clip(np.outer(lags, slopes), -CAP, CAP)


def _finding(status: Status, e_value: float, level: float, values: dict[str, int]) -> Finding:
    # Three digits: the evidence is a size, and no claim is made of its last digits.
    return Finding(status, {"e_value": float(f"{e_value:.3g}"), "threshold": 1.0 / level, "level": level, **values})


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must be in (0, 1), not {level!r}")


def _check_numbers(*values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise ValueError(f"a value must be finite, not {value!r}")

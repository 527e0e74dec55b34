"""The differences between two systems, from the robustness of their rollouts in pairs.

| symbol  | name        | meaning                                                                     | shape  | unit |
|---------|-------------|-----------------------------------------------------------------------------|--------|------|
| a_i, b_i | `a`, `b`   | robustness of the rollouts of A and B in pair i, clipped to [low, high]      | (n,)   | v    |
| s_i     | `start`     | number of the listed start of pair i                                         | (n,)   | -    |
| mu_k    |             | mean robustness of A at the listed start k                                   | ()     | v    |
| D_k     |             | that of B less mu_k                                                          | ()     | v    |
| [l, u]  |             | intervals of the mu_k, and [d, e] those of the D_k, all at once              | (K, 2) | v    |
| delta   | `delta`     | failure probability of all intervals together                                | ()     | -    |

A pair has one start and one seed. Pairs are independent with one law, so that a mean of b_i - a_i, which lies within
high - low of 0, has an interval that holds after every pair, see `mean_interval`: what both rollouts share is in none
of the differences. A failure counts 1, so that the difference of two failure probabilities is the mean of 1, 0 or -1,
and only pairs of which one fails count. A robustness of 0 is read against each side of the interval.

Worst listed start: min_k (mu_k + D_k) - min_k mu_k. Let M = min_k u_k, which no least mu is above. Where start k is the
worst of B, the difference is mu_k + D_k - min_j mu_j, at least d_k + max(0, l_k - M): a start that is surely not the
worst of A has to fall further. It is at most D_k at the worst start of A, one with l_k <= M.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ....schemas.result.comparison import ComparedQuantity, ComparisonVerdict, Difference
from ...mathematics.bounds.one_law.interval import mean_interval
from ...mathematics.bounds.rounding import round_down, round_up
from ...mathematics.gp.kernels import Floats


@dataclass(frozen=True, slots=True)
class Pairs:
    """The rollouts of two systems in pairs, in the order of their numbers."""

    a: Floats
    b: Floats
    clip: tuple[float, float] | None
    unit: str
    """Of the robustness."""
    start: Sequence[int] | None = None
    """Number of the start of each pair, where starts are listed."""
    listed: int = 0
    """How many are listed."""
    exact: bool = False
    """Whether no rollout depends on its seed, so that one pair shows all of a start."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Estimates of A and B, and an interval of B - A."""

    a: float
    b: float
    lower: float
    upper: float


def differences(pairs: Pairs, delta: float, equal: Mapping[ComparedQuantity, float]) -> tuple[Difference, ...]:
    """Return the difference in each quantity; with probability 1 - delta all intervals are right, after every pair.

    `equal` has differences that do not matter, each in the unit of its quantity. There is at least one pair.
    """
    found = quantities(pairs.clip, listed=pairs.start is not None)
    return tuple(
        judged(quantity, INTERVALS[quantity](pairs, delta / len(found)), equal.get(quantity), pairs.unit)
        for quantity in found
    )


def quantities(clip: tuple[float, float] | None, *, listed: bool) -> tuple[ComparedQuantity, ...]:
    """Return what can be compared: without a clip no mean has a bound, and only of listed starts that of the worst."""
    if clip is None:
        return ("failure_probability",)
    return ("mean", "failure_probability", *(("worst_start",) if listed else ()))


def mean_difference(pairs: Pairs, delta: float) -> Interval:
    """Return the difference of the means."""
    width = _width(pairs)
    lower, upper = mean_interval(pairs.b - pairs.a, (-width, width), delta, about=0.0)
    return Interval(float(pairs.a.mean()), float(pairs.b.mean()), lower, upper)


def failure_difference(pairs: Pairs, delta: float) -> Interval:
    """Return the difference of the failure probabilities; a robustness of 0 may be a violation, and may be none."""
    certain, possible = ((pairs.a < 0.0, pairs.b < 0.0), (pairs.a <= 0.0, pairs.b <= 0.0))
    least, most = _less(certain[1], possible[0]), _less(possible[1], certain[0])
    lower, upper = mean_interval(least, (-1.0, 1.0), delta, about=0.0)
    if not np.array_equal(least, most):
        # Each side has half of delta, of whichever values.
        upper = mean_interval(most, (-1.0, 1.0), delta, about=0.0)[1]
    return Interval(float(certain[0].mean()), float(certain[1].mean()), lower, upper)


def _less(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> Floats:
    return one.astype(np.float64) - other.astype(np.float64)


def worst_start_difference(pairs: Pairs, delta: float) -> Interval:
    """Return the difference of the least means of the listed starts, as at the head of this module."""
    assert pairs.clip is not None, "a mean has no bound without"
    assert pairs.start is not None, "of listed starts"
    numbers, width = np.array(pairs.start), _width(pairs)
    # Half of delta for A, half for the differences; each start has its part, as all are read at once.
    each = delta / 2 / pairs.listed
    middle = (pairs.clip[0] + pairs.clip[1]) / 2

    def interval(values: Floats, ends: tuple[float, float], about: float) -> tuple[float, float]:
        if pairs.exact and len(values) and (values == values[0]).all():
            return float(values[0]), float(values[0])
        return mean_interval(values, ends, each, about=about)

    at = [numbers == k for k in range(pairs.listed)]
    of_a = np.array([interval(pairs.a[here], pairs.clip, middle) for here in at])
    found = np.array([interval(pairs.b[here] - pairs.a[here], (-width, width), 0.0) for here in at])
    least = of_a[:, 1].min()
    above = np.maximum(of_a[:, 0] - least, 0.0)
    lower = max(round_down(float((found[:, 0] + above).min()) - 1e-12 * width), -width)
    upper = round_up(float(found[above == 0.0, 1].max()))
    a, b = (min(float(values[here].mean()) for here in at if here.any()) for values in (pairs.a, pairs.b))
    return Interval(a, b, lower, upper)


INTERVALS: Mapping[ComparedQuantity, Callable[[Pairs, float], Interval]] = {
    "mean": mean_difference,
    "failure_probability": failure_difference,
    "worst_start": worst_start_difference,
}
BETTER: Mapping[ComparedQuantity, Literal["larger", "smaller"]] = {
    "mean": "larger",
    "failure_probability": "smaller",
    "worst_start": "larger",
    "worst_case": "larger",
}


def _width(pairs: Pairs) -> float:
    assert pairs.clip is not None, "a mean has no bound without"
    return pairs.clip[1] - pairs.clip[0]


def judged(quantity: ComparedQuantity, found: Interval, equal: float | None, unit: str) -> Difference:
    """Return a difference with its verdict; `unit` is that of the robustness."""
    better = BETTER[quantity]
    return Difference(
        quantity=quantity,
        better=better,
        a=found.a,
        b=found.b,
        lower=found.lower,
        upper=found.upper,
        equal_within=equal,
        verdict=verdict(found.lower, found.upper, better, equal),
        unit="" if quantity == "failure_probability" else unit,
    )


def verdict(
    lower: float, upper: float, better: Literal["larger", "smaller"], equal: float | None = None
) -> ComparisonVerdict:
    """Return what an interval of B - A says of B; with `equal`, better and worse are so by more than this.

    >>> verdict(0.1, 0.3, "larger"), verdict(0.1, 0.3, "smaller"), verdict(-0.1, 0.3, "larger")
    ('BETTER', 'WORSE', 'UNDECIDED')
    >>> verdict(-0.1, 0.05, "larger", 0.1), verdict(0.2, 0.5, "smaller", 0.1), verdict(0.05, 0.5, "smaller", 0.1)
    ('EQUAL', 'WORSE', 'UNDECIDED')

    """
    # Nothing between: what more pairs decide cannot turn round, so that a stop may wait for it.
    margin = equal or 0.0
    if equal is not None and -margin <= lower and upper <= margin:
        return "EQUAL"
    if lower > margin or upper < -margin:
        return "BETTER" if (lower > margin) == (better == "larger") else "WORSE"
    return "UNDECIDED"


def overall(verdicts: Sequence[ComparisonVerdict]) -> ComparisonVerdict:
    """Return the verdict on several differences, the one first that a release must not overlook.

    >>> overall(["BETTER", "WORSE"]), overall(["BETTER", "UNDECIDED"]), overall(["EQUAL", "BETTER"])
    ('WORSE', 'UNDECIDED', 'BETTER')

    """
    order: tuple[ComparisonVerdict, ...] = ("WORSE", "UNDECIDED", "BETTER", "EQUAL")
    return next(each for each in order if each in verdicts)

"""The values of disturbances, drawn from the seeds of rollouts: the inverse transform of counter-based numbers.

| symbol | name     | meaning                                                          | shape  | unit             |
|--------|----------|------------------------------------------------------------------|--------|------------------|
| R      |          | rollouts                                                         | ()     | -                |
| k      |          | disturbances                                                     | ()     | -                |
| u      | `shares` | independent uniform numbers in (0, 1), from seed and place alone | (R, k) | -                |
| w      |          | F^-1(u), F the law of each                                       | (R, k) | of a disturbance |
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DefinitionError
from ..file.disturbance import Disturbance
from ..ranges import LARGEST_NUMBER
from .counter import open_shares
from .distributions import frozen, to_digits, truncated

Floats = NDArray[np.float64]
Inverse = Callable[[Floats], Floats]
TOLERANCE = 1e-6
"""Of a reported value, as a share of the distance between the quartiles of its law, or of its choices."""
LEAST_SHARE = 2.0**-53
"""As of `open_shares`: no score is infinite."""
DIGITS = 9
"""Significant digits of a drawn value: its last bits may differ between machines, and requests should not."""


class Laws:
    """The values of the disturbances of one system.

    >>> from perfbound.schemas.file.disturbance import Choice, Uniform
    >>> Laws([Uniform(0, 1), Choice([5, 6])]).values([7, 8]).tolist()
    [[0.444990066, 5.0], [0.443466848, 6.0]]

    """

    def __init__(self, laws: Sequence[Disturbance]) -> None:
        self._laws, self._inverses = tuple(laws), [inverse(law) for law in laws]
        self._of_scores = [of_scores(law) for law in laws]

    def values(self, seeds: ArrayLike) -> Floats:
        """Return the values (R, k) for rollouts with these seeds (R,): row r follows from its seed alone."""
        shares = open_shares(seeds, len(self._inverses))
        return np.column_stack([of(shares[:, k].copy()) for k, of in enumerate(self._inverses)])

    def scores(self, seeds: ArrayLike) -> Floats:
        """Return the scores (R, k) that the values follow from: normal quantiles of u, or the numbers of choices.

        Their laws are known whatever law was declared, so that means of functions of them are exact.
        """
        from scipy.special import ndtri  # noqa: PLC0415  (as below)

        shares = open_shares(seeds, len(self._inverses))
        columns = [
            ndtri(shares[:, k]) if law.choices is None else _place(law, shares[:, k]).astype(float)
            for k, law in enumerate(self._laws)
        ]
        return np.column_stack(columns)

    def at_scores(self, place: int, scores: ArrayLike) -> Floats:
        """Return the values (n,) of the disturbance in a place at scores (n,) as of `scores`."""
        return self._of_scores[place](np.asarray(scores, dtype=np.float64))

    @cached_property
    def middles(self) -> tuple[float, ...]:
        """The median of each: its value in variants without noise."""
        return tuple(float(of(np.array([0.5]))[0]) for of in self._inverses)


def check_law(law: Disturbance) -> None:
    """Refuse a law that has no values.

    Raises:
        DefinitionError: scipy has no such continuous distribution, does not take these numbers, or almost nothing of
            the law is between `low` and `high`.

    """
    try:
        found = Laws([law]).middles[0]
    except ValueError as error:
        raise DefinitionError(f"{law.name}: {error}") from None
    if not abs(found) <= LARGEST_NUMBER:
        raise DefinitionError(f"{law.name}: {law.words}: its median is {found}; fix its numbers")


def inverse(law: Disturbance) -> Inverse:
    """Return the inverse of the distribution function of a law: shares (n,) to values.

    Raises:
        ValueError: as `check_law`.

    """
    if law.choices is not None:
        values = np.array(law.choices)
        return lambda shares: values[_place(law, shares)]
    if (by_score := _by_score(law)) is not None:
        from scipy.special import ndtri  # noqa: PLC0415  (a tenth of a second that few commands need)

        return _rounded(law, lambda shares: by_score(ndtri(shares)))
    return _rounded(law, _truncated(law))


def coordinate(law: Disturbance) -> Inverse:
    """Return what stands for a law in a start that is drawn with it: its scores, or its choices, for shares (n,)."""
    if law.choices is not None:
        return inverse(law)
    from scipy.special import ndtri  # noqa: PLC0415  (as below)

    def scores(shares: Floats) -> Floats:
        # As `open_shares`: no score is infinite. Rounded as the values are.
        inner = (np.floor(shares * 2.0**52) + 0.5) * 2.0**-52
        return np.array(to_digits(ndtri(inner), -math.inf, math.inf, DIGITS))

    return scores


def of_scores(law: Disturbance) -> Inverse:
    """Return the values of a law at scores (n,): normal quantiles of the shares of `inverse`, or numbers of choices.

    Raises:
        ValueError: as `check_law`.

    """
    if law.choices is not None:
        values = np.array(law.choices)
        return lambda scores: values[np.rint(scores).astype(np.intp)]
    # Not through the shares: near 1 these have no digits left, and 3 standard deviations are to be 3.
    if (by_score := _by_score(law)) is not None:
        return _rounded(law, by_score)
    from scipy.special import ndtr  # noqa: PLC0415  (as above)

    exact = _truncated(law)
    return _rounded(law, lambda scores: exact(ndtr(scores)))


class ReportedLaw:
    """The law of a disturbance that a system draws and reports: where its values are in it.

    Raises:
        ValueError: as `check_law`.

    >>> ReportedLaw(Disturbance(low=0.0, high=10.0)).shares([2.5, 11.0], [0.5, 0.5]).tolist()
    [0.25, nan]

    """

    def __init__(self, law: Disturbance) -> None:
        self._choices = np.array(law.choices or ())
        if law.choices is not None:
            self._ends = np.cumsum([0.0, *law.shares])
            self._spare = TOLERANCE * float(np.ptp(self._choices))
            return
        self._score, before = _score_of(law), _before(law)
        (least, most), (low, high) = before.support(), _ends(law)
        self._low, self._high = max(low, float(least)), min(high, float(most))
        self._cdf, self._first, self._last = before.cdf, before.cdf(self._low), before.cdf(self._high)
        self._spare = TOLERANCE * float(before.ppf(0.75) - before.ppf(0.25))

    def shares(self, values: ArrayLike, between: ArrayLike) -> Floats:
        """Return the shares (n,) of values (n,): F of each, or a share within the step of F at a choice.

        `between` (n,) are numbers in [0, 1] that say where in the step. Of values that keep the law, and independent
        uniform numbers `between`, the shares are uniform. A value that the law does not have gives NaN; one up to
        `TOLERANCE` beside it counts as the nearest one that it has.
        """
        found = np.asarray(values, dtype=np.float64)
        if len(self._choices):
            places = _nearest(self._choices, found)
            steps = self._ends[places + 1] - self._ends[places]
            there = np.abs(self._choices[places] - found) <= self._spare
            return np.where(there, self._ends[places] + np.asarray(between) * steps, math.nan)
        there = (found >= self._low - self._spare) & (found <= self._high + self._spare)
        return np.where(there, self._inside(found), math.nan)

    def scores(self, values: ArrayLike) -> Floats:
        """Return the scores (n,) of values (n,), see `Laws.scores`; of one that the law does not have the nearest."""
        found = np.asarray(values, dtype=np.float64)
        if len(self._choices):
            return _nearest(self._choices, found).astype(np.float64)
        from scipy.special import ndtri  # noqa: PLC0415  (as above)

        most = -float(ndtri(LEAST_SHARE))
        if self._score is not None:
            return np.clip(self._score(found), -most, most)
        return np.asarray(ndtri(np.clip(self._inside(found), LEAST_SHARE, 1.0 - LEAST_SHARE)))

    def _inside(self, values: Floats) -> Floats:
        shares = (self._cdf(np.clip(values, self._low, self._high)) - self._first) / (self._last - self._first)
        return np.asarray(np.clip(shares, 0.0, 1.0))


class ReportedLaws:
    """The laws of what a system reports, at the values (n, k) of n rollouts."""

    def __init__(self, laws: Sequence[Disturbance]) -> None:
        self._laws = list(map(ReportedLaw, laws))

    def shares(self, values: Floats, between: Floats) -> Floats:
        """Return the shares (n, k); `between` (n, k) as of `ReportedLaw.shares`."""
        each = zip(self._laws, values.T, between.T, strict=True)
        return np.column_stack([law.shares(*columns) for law, *columns in each])

    def beside(self, drawn: Floats, values: Floats) -> Floats:
        """Return the scores (n, d + k) of rollouts with drawn disturbances, whose scores are (n, d)."""
        return np.column_stack([drawn, *(law.scores(each) for law, each in zip(self._laws, values.T, strict=True))])


def _nearest(choices: Floats, values: Floats) -> NDArray[np.intp]:
    """Return the place of the nearest choice of each value (n,)."""
    order = np.argsort(choices, kind="stable")
    ordered = choices[order]
    middles = (ordered[1:] + ordered[:-1]) / 2.0
    found: NDArray[np.intp] = order[np.searchsorted(middles, values)]
    return found


def outside(law: Disturbance, low: float, high: float, *, scored: bool) -> float:
    """Return the probability of a value that is not in [low, high], of a law without choices.

    `scored`: of a score, for which it is that of the values beyond at most, whatever the law.

    >>> round(outside(Disturbance(low=0.0, high=10.0), 1.0, 8.0, scored=False), 12)
    0.3
    """
    from scipy import stats  # noqa: PLC0415  (a second of start-up that few commands need)

    if scored:
        return float(stats.norm.cdf(low) + stats.norm.sf(high))
    (least, most), before = _ends(law), _before(law)
    ends = [(least, low), (high, most)]
    # From either side, so that no tail is a difference of numbers near 1.
    tails = [abs(of(b) - of(a)) for (a, b), of in zip(ends, (before.cdf, before.sf), strict=True)]
    return float(sum(tails) / min(abs(of(most) - of(least)) for of in (before.cdf, before.sf)))


def _rounded(law: Disturbance, exact: Inverse) -> Inverse:
    low, high = _ends(law)

    def rounded(shares: Floats) -> Floats:
        values = np.clip(exact(shares), -LARGEST_NUMBER, LARGEST_NUMBER)
        return np.array(to_digits(values, low, high, DIGITS))

    return rounded


def _ends(law: Disturbance) -> tuple[float, float]:
    return -math.inf if law.low is None else law.low, math.inf if law.high is None else law.high


def _by_score(law: Disturbance) -> Inverse | None:
    """Return the values at scores, where a formula has them."""
    if law.scipy is not None or _ends(law) != (-math.inf, math.inf):
        return None
    if law.distribution == "normal":
        mean, sd = law.described["mean"], law.described["sd"]
        return lambda scores: mean + sd * scores
    if law.distribution == "lognormal":
        median, sigma = law.described["median"], law.described["sigma"]
        return lambda scores: median * np.exp(sigma * scores)
    return None


def _score_of(law: Disturbance) -> Inverse | None:
    """Return the scores of values, where a formula has them: the inverse of `_by_score`."""
    if _by_score(law) is None:
        return None
    if law.distribution == "normal":
        mean, sd = law.described["mean"], law.described["sd"]
        return lambda values: (values - mean) / sd
    median, sigma = law.described["median"], law.described["sigma"]
    return lambda values: np.log(np.maximum(values, math.ulp(0.0)) / median) / sigma


def _truncated(law: Disturbance) -> Inverse:
    low, high = _ends(law)
    return truncated(law.distribution, law.described, low, high, before=_of_scipy(law) if law.scipy else None)


def _before(law: Disturbance) -> Any:
    """Return the distribution of scipy of which a law without choices is a part, frozen."""
    from scipy import stats  # noqa: PLC0415  (as above)

    low, high = _ends(law)
    if law.scipy is not None:
        return _of_scipy(law)
    return frozen(law.distribution, law.described, low, high) or stats.uniform(low, high - low)


def _of_scipy(law: Disturbance) -> Any:
    from scipy import stats  # noqa: PLC0415  (a second of start-up that few commands need)

    assert law.scipy is not None, "of a law by its name"
    family = getattr(stats, law.scipy, None)
    if not isinstance(family, stats.rv_continuous):
        raise ValueError(f'scipy: {law.scipy!r} is no continuous distribution of scipy.stats, such as "gumbel_r"')
    try:
        found = family(**law.numbers)
    except TypeError:
        named = ", ".join([*(family.shapes or "").split(", "), "loc", "scale"]).removeprefix(", ")
        raise ValueError(f"scipy: {law.scipy} takes {named}, not {', '.join(law.numbers) or 'no numbers'}") from None
    if not math.isfinite(found.ppf(0.5)):
        raise ValueError(f"scipy: {law.scipy} takes no such numbers: {law.numbers}; see its parameters")
    return found


def _place(law: Disturbance, shares: Floats) -> NDArray[np.intp]:
    """Return the number of the choice for each share (n,)."""
    ends = np.cumsum(law.shares)
    ends[-1] = 1.0
    found: NDArray[np.intp] = np.searchsorted(ends, shares, side="right")
    return found

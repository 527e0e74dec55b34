"""Lower confidence sequences by betting for values that are read with parameters from the past: CVaR, risk, mean.

| symbol   | name       | meaning                                                              | shape  | unit |
|----------|------------|----------------------------------------------------------------------|--------|------|
| v_j      | `value`    | a rollout, or the mean of the rollouts of a start; in [low, high]; large is good | () | v  |
| theta    |            | what is bounded: CVaR_q, the risk E[v] - r sd(v), or the mean        | ()     | v    |
| x_j      |            | reading of v_j; its mean given the past is at most theta             | ()     | v    |
| q        | `share`    | share of the worst values, in (0, 1]; CVaR_q is their mean           | ()     | -    |
| t_j      | `_bar`     | in [low, high], from v_1 .. v_(j-1) alone                            | ()     | v    |
| r        | `risk_weight` | weight of the standard deviation, r >= 0; 0 for the mean          | ()     | -    |
| c_j, s_j | `_centre`, `_spread` | in [low, high], and positive; from v_1 .. v_(j-1) alone    | ()     | v    |
| m        | `candidates` | candidates; the null  hypothesis is theta <= m                     | (G,)   | v    |
| lambda_j |            | bet on x_j at m, at most cap/(m - least x_j)                         | (G,)   | 1/v  |
| delta    | `delta`    | failure probability of a bound                                       | ()     | -    |

Readings. CVaR_q = max over t of t - E[max(t - v, 0)]/q: x_j = t_j - max(t_j - v_j, 0)/q, in [t_j - (t_j - low)/q, t_j].
Risk: x_j = v_j - (r/2)((v_j - c_j)^2/s_j + s_j), concave in v_j, so that its least value is at an end of [low, high].
Given the past, x_j has a mean of at most theta, whatever the parameters are.

So the wealth of `betting` is a supermartingale for every m >= theta if each bet is capped by the range of *this* x_j.
As there, the bound is the largest candidate up to which all are rejected, and it is valid for all n at once.

All but a share q of the starts have E[v | d] >= CVaR_q of the means v of their rollouts. If A = {d : E[v | d] < CVaR_q}
had P(A) >= q, then the worst share q of v would have a mean of at most E[v | A] < CVaR_q, a contradiction. No kernel
and no smoothness are needed.
"""

import math
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Sequence

import numpy as np

from ...control.one_law import LawControl
from ...control.sequence import Control, Disturbed
from ...gp.kernels import Floats
from ..rounding import ROUND_OFF, round_down
from .betting import BOLD_AND_CAREFUL
from .many import are_within, exact_sum, linearised_each, pieces, squares
from .risk import RiskReading, check_clip
from .wealth import GRID, Moments, Strategy, Wealth

STRATEGIES = (Strategy(0.9, 0.95, 1.0), Strategy(0.1, 0.5))
"""For CVaR the largest bets are nearly always best: the least x, which caps them, is far below the others."""
RENEWAL = 1.05
"""The parameters, and the moments of x at them, are computed anew when there are this many times as many values."""
LEAST_SPREAD = 1e-3
"""s_j is at least this share of the range."""


class PredictableSequence(ABC):
    """Lower bound of theta, valid for all n at once; the running maximum.

    `least` is a value that theta is never below. Work per value is O(G), and only on candidates between the bound and
    the mean aimed at; a value takes 8 bytes. With disturbances, x less what a control explains of it takes the place of
    x; `farthest` is how far below the range the control is fitted to x, and a value takes 24 bytes.

    Raises:
        ValueError: the range is empty or infinite, or delta is outside (0, 1).

    """

    def __init__(
        self,
        least: float,
        clip: tuple[float, float],
        delta: float,
        strategies: Sequence[Strategy],
        *,
        disturbed: Disturbed | None = None,
        farthest: float = 1.0,
    ) -> None:
        if not 0.0 < delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {delta!r}")
        self._low, self._high = check_clip(clip)
        self._least = least
        candidates = least + (self._high - least) * (np.arange(GRID) / GRID)  # (G,)
        self._bets = Wealth(candidates, strategies, [(1.0 + ROUND_OFF) / delta])
        self._sorted, self._fresh = np.empty(0), array("d")  # values up to the last renewal, and those since
        self._renewal, self._reported = 1.0, (0, least)  # the bound, for the rejected candidates that it follows from
        self._weight = self._mean = self._squares = 0.0  # moments of x at the current parameters
        self._law = None
        if disturbed is not None:
            self._law = LawControl(disturbed, (self._high - farthest * (self._high - self._low), self._high), delta)
        self._ordered, self._explained = array("d"), array("d")  # values in their order, and what is taken from each
        self._first: list[Floats] = []  # the scores of those before the first fit

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the values before its first fit; None where there is none."""
        if self._law is None or self._law.control is None:
            return None
        return self._law.control, self._law.before_fit

    @property
    def count(self) -> int:
        """Number of values n."""
        return len(self._sorted) + len(self._fresh)

    @property
    def estimate(self) -> float:
        """Mean of x at the current parameters, an estimate of theta; 0 without a value."""
        return self._mean

    def lower(self) -> float:
        """Return the bound, in the unit of v, rounded down to 1e-9; `least` while nothing is rejected."""
        rejected = self._bets.rejected[0]
        if rejected > self._reported[0]:
            # The candidate as computed may be a rounding error above its definition.
            found = round_down(float(self._bets.candidates[rejected]) - 1e-12 * (self._high - self._least))
            self._reported = rejected, max(found, self._least)
        return self._reported[1]

    def add(self, value: float) -> None:
        """Add the next value; raises as `add_each`."""
        self.add_each(np.array([value], dtype=np.float64))

    def add_each(self, values: Floats, scores: Floats | None = None) -> None:
        """Add the next values (k,) in their order; with disturbances also the scores of their rollouts.

        Raises:
            ValueError: one is outside the range; nothing changes.

        """
        if not are_within(values, self._low, self._high):
            wrong = values[~((values >= self._low) & (values <= self._high))]
            raise ValueError(f"a value must be in [{self._low}, {self._high}], not {float(wrong[0])!r}")
        while len(values):
            # Up to the renewal the parameters are the same.
            ahead = values[: max(math.ceil(self._renewal) - self.count, 1)]
            is_new = False
            if self._law is None or scores is None:
                x = self._read(ahead)
                self._bets.play(x, self._before(x))
            else:
                ahead = ahead[: self._law.ahead]
                is_new, scores = self._play_less(self._law, ahead, scores[: len(ahead)]), scores[len(ahead) :]
            self._fresh.frombytes(ahead.tobytes())
            if self.count >= self._renewal:
                self._renewal = RENEWAL * self.count
                self._begin_anew()
            elif is_new:
                self._take_less()
                self._limit()
            values = values[len(ahead) :]

    def _play_less(self, law: LawControl, values: Floats, scores: Floats) -> bool:
        """Bet on x less what the control explains of it, and return whether it explains the next values otherwise."""
        x, g = self._read(values), law.g(scores)
        self._bets.play(x - g, self._before(x - g))
        self._ordered.frombytes(values.tobytes())
        self._explained.frombytes(g.tobytes())
        begins = not law.has_begun
        if begins:
            self._first.append(scores)
        is_new = law.add(scores, x, lambda: max(self._mean - self._least_x(), 1e-9 * (self._high - self._low)))
        if begins and is_new:
            self._explained = array("d", np.concatenate([law.g(each) for each in self._first]).tobytes())
            self._first.clear()
        return is_new

    @abstractmethod
    def _read(self, values: Floats) -> Floats:
        """Return x of values (k,) at the current parameters."""

    @abstractmethod
    def _least_x(self) -> float:
        """Return the least x that a value can have at the current parameters."""

    @abstractmethod
    def _renew(self) -> None:
        """Choose the parameters for the next values, and compute the moments of x of all values at them."""

    def _begin_anew(self) -> None:
        # A stable sort finds the long sorted part and merges the new values, with equal ones in their order.
        self._sorted = np.sort(np.concatenate([self._sorted, self._fresh]), kind="stable")
        self._fresh = array("d")
        self._renew()
        if self.control is not None:
            self._take_less()
        self._limit()

    def _limit(self) -> None:
        # Every factor of the wealth stays at least 1 - cap > 0, also for the least x that these parameters allow.
        least = self._least_x() - (self._law.most if self._law else 0.0)
        self._bets.limit(np.maximum(self._bets.candidates - least, 1e-9 * (self._high - self._low)))

    def _take_less(self) -> None:
        """Compute the moments of all values, less what was explained of them."""
        x = self._read(np.array(self._ordered)) - np.array(self._explained)
        self._weight, self._mean = float(len(x)), exact_sum(x) / len(x)
        self._squares = exact_sum(squares(x - self._mean))

    def _before(self, x: Floats) -> Moments:
        """Add x (k,) to the moments, and return those before each of them."""
        if not self._weight:  # the first value: nothing is aimed at
            self._take(x.tolist())
            return np.array([[-math.inf, 0.0, 0.0]])
        weights = self._weight + np.arange(len(x))
        seen: list[tuple[float, float, float]] = []
        self._take(x.tolist(), seen)
        found = np.array(seen)
        found[:, 1] /= weights
        found[:, 2] = np.sqrt(found[:, 1] / weights)
        return found

    def _take(self, x: Sequence[float], before: list[tuple[float, float, float]] | None = None) -> None:
        """Add x to the moments [Welford's update], and note mean and sum of squares before each of them."""
        weight, mean, squared = self._weight, self._mean, self._squares
        for each in x:
            if before is not None:
                before.append((mean, squared, 0.0))
            weight += 1.0
            shift = each - mean
            mean += shift / weight
            squared += shift * (each - mean)
        self._weight, self._mean, self._squares = weight, mean, squared


def sample_quantile(values: Sequence[float] | Floats, share: float, low: float, delta: float) -> int:  # noqa: ARG001
    """Return the index of the sample quantile in the sorted values: the t of the sample's own CVaR.

    >>> sample_quantile([0.1, 0.2, 0.4, 0.8], 0.5, 0.0, 0.05)
    1

    """
    return max(math.ceil(share * len(values)) - 1, 0)


def best_expected(values: Sequence[float] | Floats, share: float, low: float, delta: float) -> int:
    """Return the index in the sorted values of the t for which the bound after as many values again is expected best.

    A constant bet lambda finds, to second order, the mean of x less ln(1/delta)/(n lambda) + lambda var(x)/2; lambda is
    the best one below the largest bet. At a jump of the quantile function this t stays where x varies little, and the
    sample quantile does not.

    >>> best_expected([0.1, 0.2, 0.4, 0.8], 0.5, 0.0, 0.05)
    0

    """
    n = len(values)
    t = np.array(values[: min(2 * math.ceil(share * n), n)])
    before = np.arange(len(t))
    # Sums of max(t - v, 0) and of its square; rounding may cost a good t, and never the validity of a bound.
    total, squares = (np.concatenate(([0.0], np.cumsum(each)[:-1])) for each in (t, t * t))
    first, second = (before * t - total) / n, np.maximum(before * t * t - 2.0 * t * total + squares, 0.0) / n
    variance = np.maximum(second - first * first, 0.0) / share**2
    room = np.maximum((t - low) / share, 1e-300)
    cost = math.log(1.0 / delta) / n
    largest = STRATEGIES[0].cap / room
    bet = np.minimum(np.sqrt(2.0 * cost / np.maximum(variance, 1e-300)), largest)
    return int(np.argmax(t - first / share - cost / bet - bet * variance / 2.0))


Choice = Callable[[Floats, float, float, float], int]
"""From the sorted values, q, low and delta to the index of the next t in them."""


class CvarSequence(PredictableSequence):
    """Lower bound of CVaR_q, the mean of the worst share q of the clipped values, valid for all n at once.
    Implements eq. (all but a share) of [PB].

    Formula: betting on x_j as at the head of this module, t_j one of the values before by the rule `choice`, and `high`
    for q = 1, where CVaR is the mean. The running maximum. Assumes independent values of one distribution: single
    rollouts at starts drawn from it, or the means of equally many rollouts a start; then the bound is also one of
    E[v | d] for all starts but a share q. For the risk in place of E[v | d] a rollout counts with its linearised risk.

    Raises:
        ValueError: the range is empty or infinite, `share` is outside (0, 1], or `delta` outside (0, 1).

    >>> bound = CvarSequence(0.1, (0.0, 1.0), delta=0.05)
    >>> for j in range(400):
    ...     bound.add(0.6 + 0.001 * (j * 37 % 100))  # the worst tenth has the mean .6045
    >>> bound.count, round(bound.lower(), 3)
    (400, 0.554)

    """

    def __init__(
        self,
        share: float,
        clip: tuple[float, float],
        *,
        delta: float,
        choice: Choice = best_expected,
        disturbed: Disturbed | None = None,
    ) -> None:
        if not 0.0 < share <= 1.0:
            raise ValueError(f"share must be in (0, 1], not {share!r}")
        super().__init__(clip[0], clip, delta, STRATEGIES, disturbed=disturbed, farthest=1.0 / share)
        self._share, self._bar, self._choice, self._delta = share, clip[0], choice, delta

    def _read(self, values: Floats) -> Floats:
        return self._bar - np.maximum(self._bar - values, 0.0) / self._share

    def _least_x(self) -> float:
        return self._bar - (self._bar - self._low) / self._share

    def _renew(self) -> None:
        """Move t to one of the values, and compute the moments of x at it."""
        if self._share < 1.0:
            worst = self._choice(self._sorted, self._share, self._low, self._delta)
            self._bar = float(self._sorted[worst])
        else:
            worst, self._bar = self.count, self._high
        self._weight = self._mean = self._squares = 0.0
        for piece in pieces(self._sorted[:worst]):
            self._take(self._read(piece).tolist())
        # All others have x = t: they enter the moments together.
        above, shift = self.count - worst, self._bar - self._mean
        self._squares += shift * shift * worst * above / self.count
        self._mean += shift * above / self.count
        self._weight = float(self.count)


class RiskSequence(PredictableSequence):
    """Lower bound of the risk E[v] - r sd(v) of the clipped values, or of their mean (r = 0), valid for all n at once.
    Implements eq. (predictable risk) of [PB].

    Formula: betting on x_j as at the head of this module; c_j is the mean of the values before, and s_j^2 is their
    variance plus R^2 ln(1/delta)/n, R the distance of c_j to the farther end of the range. The running maximum. The
    second term is what a small s costs: the least x falls like R^2/s, and with it the largest bet. Assumes values that
    are independent with one law; r is fixed beforehand, c and s need no guess.

    Raises:
        ValueError: the range is empty or infinite, r is negative, or `delta` is outside (0, 1).

    >>> bound = RiskSequence(0.2, (-0.05, 0.75), delta=0.05)
    >>> for j in range(400):
    ...     bound.add(0.6 + 0.001 * (j * 37 % 100))  # mean .6495, sd .0289: a risk of .6437
    >>> bound.count, round(bound.lower(), 3)
    (400, 0.626)

    """

    def __init__(
        self, risk_weight: float, clip: tuple[float, float], *, delta: float, disturbed: Disturbed | None = None
    ) -> None:
        super().__init__(
            RiskReading(clip, risk_weight, None).least, clip, delta, BOLD_AND_CAREFUL, disturbed=disturbed, farthest=2.0
        )
        self._risk_weight, self._cost = risk_weight, math.log(1.0 / delta)
        self._centre, self._spread = 0.5 * (clip[0] + clip[1]), 0.5 * (clip[1] - clip[0])

    def _read(self, values: Floats) -> Floats:
        return linearised_each(values, squares(values - self._centre), self._risk_weight, self._spread)

    def _least_x(self) -> float:
        return float(self._read(np.array([self._low, self._high])).min())

    def _renew(self) -> None:
        """Move c and s to the moments of the values."""
        n, values = self.count, self._sorted
        self._centre = min(max(exact_sum(values) / n, self._low), self._high)
        squared = squares(values - self._centre)
        variance = exact_sum(squared) / n
        farther = max(self._centre - self._low, self._high - self._centre)
        spread = math.sqrt(variance + farther**2 * self._cost / n)
        self._spread = max(spread, LEAST_SPREAD * (self._high - self._low))
        x = linearised_each(values, squared, self._risk_weight, self._spread)
        self._weight, self._mean = float(n), exact_sum(x) / n
        self._squares = exact_sum(squares(x - self._mean))

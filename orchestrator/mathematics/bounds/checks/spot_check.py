"""Spot check: fresh uniform starts that test what a campaign claims for every start, without smoothness.

| symbol   | name          | meaning                                                         | shape  | unit      |
|----------|---------------|-----------------------------------------------------------------|--------|-----------|
| m        | `starts`      | starts drawn uniformly from D, after all limits were fixed      | (m, p) | parameter |
| J        | `value`       | maximised objective of one rollout, in [low, high]              | ()     | unit J    |
| u        | `limit`       | the claim under test: E[J(d)] <= u for every d in D             | ()     | unit J    |
| e        | `excess`      | J - u; its mean is at most 0 under the claim                    | ()     | unit J    |
| R        | `scale`       | sub-Gaussian scale of one rollout, where it is given            | ()     | unit J    |
| lambda_s |               | bet of strategy s on the next e of a start, from the past alone | (S,)   | 1/unit J  |
| W_j      | `own`         | wealth of start j, mean over s of prod (1 + lambda_s e)         | (m,)   | -         |
| V        | `joint`       | the same product over the follow-ups at all starts              | ()     | -         |
| W        | `wealth`      | (mean of W_j + V)/2                                             | ()     | -         |
| delta    | `delta`       | failure probability, for each hypothesis its own                | ()     | -         |
| k        | `violations`  | starts whose first rollout has J > u                            | ()     | -         |

Noise that is sub-Gaussian of scale R has the factor exp(lambda e - lambda^2 R^2/2), whose mean is at most 1 under the
claim for every lambda >= 0; the test is then one of the claim and of R together. With a range and an R both kinds of
factors share the wealth: where the range is many times R, a bet that no value of the range may ruin gains next to
nothing. Follow-ups end by the bets within the range: a start that is named by R and one rollout would leave little to
see of it.

A deterministic J shows at each start whether the claim is true there: one violation refutes it, and k of m bound the
violated share of D (Clopper-Pearson). For a noisy J, 0 <= lambda <= CAP/(u - low) is a function of the rollouts before
this one, so every factor is positive with a mean of at most 1 under the claim. Hence (1/m) sum_j W_j is a positive
supermartingale that starts at 1, whatever rule chooses the starts from past rollouts, provided that *every* rollout
enters, including the one that made a start suspicious. So is V: a follow-up is a fresh rollout, whose mean given the
past is at most u wherever it is made, and V bets on no other. W_j needs many rollouts at one bad start, V some at each
of many that are little worse than u. By Ville W reaches 1/delta with probability at most delta. W_j >= 2m/delta implies
this, so a start is named at its own 2m/delta without another failure probability.

Rollouts enter in test order. All arithmetic is +, -, *, / and sqrt of doubles in a fixed order, so that every CPU
proposes the same tests; with a scale R it is also exp, whose last digits decide nothing but when a start is named.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .....schemas.values import Proposal
from ...gp.kernels import Floats
from ...gp.lattice import check_index
from ..one_law.share import clopper_pearson_upper
from ..rounding import RICHEST, ROUND_OFF, decimal, floor_to_step

# The wealth of the bets

DEFICITS = (0.25, 0.5, 1.0, 2.0)
"""Each strategy bets what is best (Kelly, second order) for this mean excess, in standard deviations of a rollout."""


class SpotWealth:
    """The wealth of one kind of bets: own ones of every start, and the joint one of follow-ups."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._own = np.full((len(DEFICITS), size), 1.0 / len(DEFICITS))  # (S, m)
        self._joint = np.full(len(DEFICITS), 1.0 / len(DEFICITS))  # (S,)

    def bet(self, node: int, factors: Sequence[float], *, joins: bool) -> None:
        """Multiply the wealth of every strategy at a start, and of follow-ups if this is one that `joins` them."""
        # As numbers of Python: one that overflows is infinite, and not a warning.
        for s, factor in enumerate(factors):
            self._own[s, node] = min(float(self._own[s, node]) * factor, RICHEST)
            self._joint[s] = min(float(self._joint[s]) * factor, RICHEST) if joins else self._joint[s]

    def own(self, node: int) -> float:
        """W_j of a start."""
        return math.fsum(self._own[:, node])

    @property
    def whole(self) -> float:
        """W."""
        # Half each: the mean over the starts names one that is bad, the joint bets show many that are a little too bad.
        return (math.fsum(self._own.ravel()) / self._size + math.fsum(self._joint)) / 2.0


# Mean and standard deviation of the rollouts at many starts, most of which have few

BORROWED = 3.0
"""Degrees of freedom that a start without enough rollouts of its own takes from all starts."""


class Spread:
    """Mean excess of every start, and a standard deviation of one rollout that small samples share.

    The variance within starts is pooled; while it has few degrees of freedom, the variance between first rollouts
    counts as BORROWED of them, and a quarter of the range as the first of those. A start's own variance enters by its
    degrees of freedom. It serves bets and choices, which may be any function of the past: no claim depends on it.
    """

    def __init__(self, size: int, width: float) -> None:
        self.count = np.zeros(size)  # (m,)
        self.mean = np.zeros(size)  # (m,) unit J
        self._squares = np.zeros(size)  # (m,) squared deviations from the mean of the start
        self._within = self._degrees = 0.0  # sums over the starts
        self._started = self._centre = 0.0  # number and mean of the first rollouts
        self._between = (width / 4.0) ** 2 if math.isfinite(width) else 1.0
        self._least = 1e-6 * width if math.isfinite(width) else 1e-6

    def add(self, node: int, excess: float) -> None:
        """Add the excess of one rollout [Welford's update]."""
        if self.count[node]:
            self._degrees += 1.0
        else:
            self._started += 1.0
            shift = excess - self._centre
            self._centre += shift / self._started
            self._between += shift * (excess - self._centre)
        self.count[node] += 1.0
        shift = excess - self.mean[node]
        self.mean[node] += shift / self.count[node]
        square = shift * (excess - self.mean[node])
        self._squares[node] += square
        self._within += square

    def sd(self) -> Floats:
        """Return the estimated standard deviation of one rollout at every start (m,), positive."""
        between = self._between / (self._started + 1.0)
        common = (self._within + BORROWED * between) / (self._degrees + BORROWED)
        own = (self._squares + BORROWED * common) / (np.maximum(self.count - 1.0, 0.0) + BORROWED)
        return np.maximum(np.sqrt(own), self._least)


VIOLATION = 1e-9
"""A deterministic value violates the limit from this excess on: less is the round-off of the simulator."""
CAP = 0.95
"""Largest share of the wealth of a start that one rollout may cost."""
MOST_EXPONENT = 500.0
OUTSIDE = 1e-9
"""A value may leave its range by this much, which is round-off."""
EXPLORE = 1.0
"""Weight of the standard error in the choice of a follow-up."""
SUSPICIOUS = 2.0
"""A start is suspicious while its mean excess plus this many standard errors is positive."""

Marks = NDArray[np.bool_]
SpotStatus = Literal["refuted", "not refuted", "not testable", "beyond"]


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """The claim E[J(d)] <= limit for every d; `low` and `high` enclose J of one rollout, None where nothing does.

    `scale` is that of sub-Gaussian noise that the claim rests on; a value without a range needs one to be tested.

    Raises:
        ValueError: the limit is not finite, the range is empty, infinite or half given, or the scale is not positive.

    """

    name: str
    limit: float
    low: float | None
    high: float | None
    noisy: bool
    scale: float | None = None

    def __post_init__(self) -> None:
        """Check limit, range and scale."""
        if self.scale is not None and not 0.0 < self.scale < math.inf:
            raise ValueError(f"{self.name}: the scale must be positive and finite, not {self.scale!r}")
        if not math.isfinite(self.limit):
            raise ValueError(f"{self.name}: the limit must be finite, not {self.limit!r}")
        if (self.low is None) != (self.high is None):
            raise ValueError(f"{self.name}: give both ends of the range, or neither")
        if self.low is not None and self.high is not None and not -math.inf < self.low < self.high < math.inf:
            raise ValueError(f"{self.name}: the range [{self.low!r}, {self.high!r}] must be finite and not empty")


@dataclass(frozen=True, slots=True)
class SpotFinding:
    """The result for one hypothesis; `not refuted` is no evidence beyond `share`.

    `not testable`: the values are noisy, and neither bounded nor of a known scale, so that no bet is safe. `beyond`:
    the limit is false in D, and the claim is about a part of D alone.
    """

    name: str
    status: SpotStatus
    starts: int
    """Starts with at least one rollout."""
    rollouts: int
    violations: int
    """Starts whose first rollout exceeds the limit; refutes the claim only if the objective is deterministic."""
    share: float | None = None
    """Deterministic: the claim is false in at most this share of D, at 1 - delta; a missing start is a violation."""
    start: int | None = None
    """Deterministic: the worst violating start. Noisy: the start of the largest wealth of at least 2m/delta."""
    wealth: float | None = None
    """Noisy: largest W so far; 1/delta refutes the claim."""
    undecided: int | None = None
    """Noisy: starts that are still suspicious, and not named."""


class SpotTests:
    """The choice of starts and the tests of all hypotheses; the state is a function of the observations alone.
    Implements eq. (spot check) of [PB].

    `starts` (m, p) are drawn uniformly from D by the caller, after every limit was fixed; their rollouts have seeds of
    their own. The first m tests visit them in order; up to `followups` further ones return to the starts where a noisy
    bounded objective is largest relative to its limit. Every test has `replicates` rollouts. Not thread-safe.

    Raises:
        ValueError: no start or no hypothesis, differing lengths, a number outside its range, or a name given twice.

    >>> check = SpotTests(((0.0,), (1.0,), (2.0,)), (Hypothesis("gap", 0.5, None, None, noisy=False),), followups=10)
    >>> for value in (0.4, 0.7, 0.3):
    ...     check.observe(check.propose().node, [value])
    >>> finding = check.finding(0)
    >>> finding.status, finding.violations, finding.start, finding.share, check.propose()
    ('refuted', 1, 1, 0.864649638, None)

    """

    def __init__(
        self,
        starts: Sequence[Sequence[float]],
        hypotheses: Sequence[Hypothesis],
        *,
        followups: int,
        replicates: int = 1,
        delta: float = 0.05,
    ) -> None:
        _check_plan(starts, hypotheses, followups, replicates, delta)
        self._starts = tuple(tuple(float(v) for v in start) for start in starts)
        self._hypotheses = tuple(hypotheses)
        self._followups, self._replicates, self._delta = followups, replicates, delta
        self._records = tuple(_Record(hypothesis, len(starts), delta) for hypothesis in hypotheses)
        self._rollouts = 0

    @property
    def size(self) -> int:
        """Number of starts m."""
        return len(self._starts)

    @property
    def rollouts(self) -> int:
        """Number of rollouts observed."""
        return self._rollouts

    def propose(self, pending: Sequence[int] = ()) -> Proposal | None:
        """Return the next test, given the starts of the tests in flight; it changes nothing.

        None while tests are in flight means that nothing is to be done before one of them ends, and None without
        one that the check is complete: every start has its rollout, and either the follow-ups are spent, every noisy
        hypothesis has a named start, or no start is suspicious. `mu` and `sigma` of a follow-up are the mean of the
        objective that chose it and its standard error.

        Raises:
            IndexError: an entry of `pending` is no start.

        """
        flying = np.zeros(self.size)
        for node in pending:
            check_index(node, self.size)
            flying[node] += self._replicates
        untested = np.flatnonzero((self._records[0].count == 0) & (flying == 0))
        if untested.size:
            return self._proposal(int(untested[0]), None, None)
        if self.rollouts // self._replicates + len(pending) >= self.size + self._followups:
            return None
        return self._followup(flying)

    def observe(self, node: int, values: Sequence[float]) -> None:
        """Add J of one rollout at a start, one value for each hypothesis in order; on an error nothing changes.

        Raises:
            ValueError: the number of values is wrong, or one is not finite or outside its range.
            IndexError: `node` is no start.

        """
        check_index(node, self.size)
        if len(values) != len(self._records):
            raise ValueError(f"a rollout needs {len(self._records)} values, one for each hypothesis; not {len(values)}")
        for hypothesis, value in zip(self._hypotheses, values, strict=True):
            _check_value(hypothesis, value)
        self._rollouts += 1
        for record, value in zip(self._records, values, strict=True):
            record.add(node, value)

    def finding(self, k: int) -> SpotFinding:
        """Return the result for hypothesis k, valid at every time.

        Raises:
            IndexError: there is no such hypothesis.

        """
        check_index(k, len(self._records))
        return self._records[k].finding()

    def first_values(self, k: int) -> tuple[float | None, ...]:
        """Return J of the first rollout of every start (m,), None where there is none; the input of `failure_share`."""
        check_index(k, len(self._records))
        return tuple(None if math.isnan(v) else float(v) for v in self._records[k].first)

    def _followup(self, flying: Floats) -> Proposal | None:
        """Return the follow-up at the most suspicious start of all open hypotheses; ties go to the first."""
        best: tuple[float, int, _Record] | None = None
        for record in self._records:
            if not record.followed:
                continue
            score = record.scores(flying)
            node = int(np.argmax(score))
            if score[node] > -math.inf and (best is None or score[node] > best[0]):
                best = (float(score[node]), node, record)
        if best is None:
            return None
        _, node, record = best
        return self._proposal(node, *record.estimate(node))

    def _proposal(self, node: int, mu: float | None, sigma: float | None) -> Proposal:
        return Proposal(node, self._starts[node], mu, sigma, None, None)


class _Record:
    """The rollouts of one hypothesis at every start, the bets on them, and the finding."""

    def __init__(self, hypothesis: Hypothesis, size: int, delta: float) -> None:
        self._hypothesis, self._delta, self._size = hypothesis, delta, size
        low, high = hypothesis.low, hypothesis.high
        self.bounded = low is not None and high is not None
        self._low, self._high = (low, high) if low is not None and high is not None else (-math.inf, math.inf)
        self.first = np.full(size, math.nan)  # (m,) J of the first rollout
        kinds = [
            *([self._bounded_factor] if self.bounded else []),
            *([self._scaled_factor] if hypothesis.scale else []),
        ]
        self._kinds = [(factor, SpotWealth(size)) for factor in kinds]
        width = 4.0 * hypothesis.scale if hypothesis.scale is not None else math.inf
        self._spread = Spread(size, self._high - self._low if self.bounded else width)
        self._peak = 1.0  # of W
        self._own_peak = np.ones(size)  # (m,)
        self._first_peak = np.ones(size)  # (m,) of the first kind of bets alone

    @property
    def count(self) -> Floats:
        """Rollouts of every start (m,)."""
        return self._spread.count

    @property
    def followed(self) -> bool:
        """Whether follow-ups can change the finding, or what the rollouts show without any noise scale."""
        open_ = self._hypothesis.limit < self._high and _richest(self._first_peak) < self._threshold
        return self._hypothesis.noisy and bool(self._kinds) and open_

    def add(self, node: int, value: float) -> None:
        """Bet on one value in the range, then add it to the past; without noise a second value adds nothing."""
        if not self._hypothesis.noisy and self.count[node]:
            return
        excess = value - self._hypothesis.limit
        if self._hypothesis.noisy and self._kinds:
            self._bet(node, excess)
        if not self.count[node]:
            self.first[node] = value
        self._spread.add(node, excess)

    def scores(self, flying: Floats) -> Floats:
        """Return how promising a follow-up is at every start (m,), in standard deviations; -inf where it is not.

        A test in flight counts as a rollout that leaves the mean unchanged: that spreads a window over the starts.
        """
        bonus = EXPLORE / np.sqrt(np.maximum(self.count + flying, 1.0))
        return np.where(self._suspicious(), self._spread.mean / self._spread.sd() + bonus, -math.inf)

    def estimate(self, node: int) -> tuple[float, float]:
        """Return the mean of J at a start and its standard error, unit J."""
        error = float(self._spread.sd()[node]) / math.sqrt(max(self.count[node], 1.0))
        return float(self._hypothesis.limit + self._spread.mean[node]), error

    def finding(self) -> SpotFinding:
        """Return the result so far."""
        starts, rollouts = int(np.count_nonzero(self.count)), int(self.count.sum())
        excess = np.where(self.count > 0, self.first - self._hypothesis.limit, -math.inf)
        violations = int(np.count_nonzero(excess > VIOLATION))
        found = SpotFinding(self._hypothesis.name, "not refuted", starts, rollouts, violations)
        if not self._hypothesis.noisy:
            # A start that is missing may be missing because of its outcome.
            share = clopper_pearson_upper(violations + self._size - starts, self._size, self._delta)
            worst = int(np.argmax(excess)) if violations else None
            return replace(found, status="refuted" if violations else "not refuted", share=share, start=worst)
        if not self._kinds:
            return replace(found, status="not testable")
        status: SpotStatus = "refuted" if self._peak >= (1.0 + ROUND_OFF) / self._delta else "not refuted"
        undecided = int(np.count_nonzero(self._suspicious() & (self._own_peak < self._threshold)))
        return replace(found, status=status, start=self._named(), wealth=self._peak, undecided=undecided)

    @property
    def _threshold(self) -> float:
        """Wealth from which a start is named."""
        return 2.0 * self._size * (1.0 + ROUND_OFF) / self._delta

    def _named(self) -> int | None:
        return int(np.argmax(self._own_peak)) if _richest(self._own_peak) >= self._threshold else None

    def _suspicious(self) -> Marks:
        """Return whether the mean excess of every start (m,) may be positive."""
        reach = self._spread.mean + SUSPICIOUS * self._spread.sd() / np.sqrt(np.maximum(self.count, 1.0))
        return (self.count > 0) & (reach > 0)

    def _bet(self, node: int, excess: float) -> None:
        """Move the wealth of one start; the bets are functions of the rollouts before this one."""
        sd = float(self._spread.sd()[node])
        # At a start whose past mean keeps the limit, V can only lose.
        joins = bool(self.count[node] > 0 and self._spread.mean[node] > 0)
        for factor, wealth in self._kinds:
            wealth.bet(node, [factor(deficit, sd, excess) for deficit in DEFICITS], joins=joins)
        each = [wealth for _, wealth in self._kinds]
        own = math.fsum(wealth.own(node) for wealth in each) / len(each)
        self._own_peak[node] = max(self._own_peak[node], own)
        self._first_peak[node] = max(self._first_peak[node], each[0].own(node))
        self._peak = max(self._peak, math.fsum(wealth.whole for wealth in each) / len(each))

    def _bounded_factor(self, deficit: float, sd: float, excess: float) -> float:
        # Every factor is at least 1 - CAP, also for a value that leaves the range by round-off. A limit below the range
        # leaves no room for a loss: any finite bet is safe.
        largest = CAP / max(self._hypothesis.limit - self._low + OUTSIDE, OUTSIDE)
        return 1.0 + min(deficit / (sd * (1.0 + deficit * deficit)), largest) * excess

    def _scaled_factor(self, deficit: float, _sd: float, excess: float) -> float:
        # The best lambda for a mean excess of `deficit` scales; the exponent is capped, so that nothing overflows.
        assert self._hypothesis.scale is not None
        return math.exp(min(deficit * excess / self._hypothesis.scale - deficit * deficit / 2.0, MOST_EXPONENT))


def _richest(wealth: Floats) -> float:
    return float(wealth.max())


def failure_share(failures: int, count: int, theta: float, delta: float) -> float:
    """Return an upper bound of the share of D where a rollout fails with probability theta or more.
    Implements eq. (failure share) of [PB].

    Formula: min(1, p/theta) with p = `clopper_pearson_upper(failures, count, delta)` by Markov's inequality, rounded
    up to 1e-9; valid for every theta at once. Assumes `count` starts drawn uniformly from D, a number fixed
    beforehand, with *one* rollout each: follow-ups never enter, and a rollout that is missing is a failure.

    Raises:
        ValueError: theta is outside (0, 1], or `failures`, `count` or `delta` are outside their ranges.

    >>> failure_share(0, 299, 0.5, 0.05)
    0.019938294

    """
    if not 0.0 < theta <= 1.0:
        raise ValueError(f"theta must be in (0, 1], not {theta!r}")
    p = clopper_pearson_upper(failures, count, delta)
    return min(1.0, -floor_to_step(-decimal(p) / decimal(theta)))


def _check_plan(
    starts: Sequence[Sequence[float]], hypotheses: Sequence[Hypothesis], followups: int, replicates: int, delta: float
) -> None:
    if not starts or not hypotheses:
        raise ValueError("a spot check needs at least one start and one hypothesis")
    if len({len(start) for start in starts}) > 1 or not all(math.isfinite(v) for start in starts for v in start):
        raise ValueError("the starts must be finite points of one dimension")
    names = [hypothesis.name for hypothesis in hypotheses]
    if len(set(names)) < len(names):
        raise ValueError(f"the names of the hypotheses must differ: {names}")
    if followups < 0 or replicates < 1 or not 0.0 < delta < 1.0:
        given = f"{followups!r}, {replicates!r} and {delta!r}"
        raise ValueError(f"followups must be >= 0, replicates positive and delta in (0, 1), not {given}")


def _check_value(hypothesis: Hypothesis, value: float) -> None:
    low = -math.inf if hypothesis.low is None else hypothesis.low - OUTSIDE
    high = math.inf if hypothesis.high is None else hypothesis.high + OUTSIDE
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{hypothesis.name}: a value must be finite and in [{low}, {high}], not {value!r}")

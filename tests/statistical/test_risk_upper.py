"""The risk at a start: wealth of mean at most 1, false bounds at most as often as stated, power, mistakes caught."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from perfbound.orchestrator.mathematics.bounds.one_law.betting import BOLD_AND_CAREFUL, BettingSequence, Past
from perfbound.orchestrator.mathematics.bounds.one_law.risk_upper import RiskUpperBound
from perfbound.orchestrator.mathematics.bounds.one_law.wealth import GRID

Floats = NDArray[np.float64]
DELTA = 0.05
CLIP = (-0.05, 0.75)
WIDTH = CLIP[1] - CLIP[0]
SIZES = [10_000, pytest.param(100_000, marks=pytest.mark.slow)]


def wealth(x: Floats, m: float) -> Floats:
    """Return the wealth (R, n) of the lower bound of a mean at one candidate, after each of the values (R, n)."""
    runs, count = x.shape
    total, squares, shares = np.zeros(runs), np.zeros(runs), np.repeat([[s.share] for s in BOLD_AND_CAREFUL], runs, 1)
    found = np.empty((runs, count))
    for n in range(count):
        if n:
            mean = total / n
            variance = np.maximum(squares / n - mean**2, 0.0)
            for s, strategy in enumerate(BOLD_AND_CAREFUL):
                edge = np.maximum(mean + strategy.optimism * np.sqrt(variance / n) - m, 0.0)
                spread = variance + edge * edge
                bet = np.divide(edge, spread, out=np.zeros(runs), where=spread > 0)
                shares[s] *= 1.0 + np.minimum(bet, strategy.cap / m) * (x[:, n] - m)
        total, squares = total + x[:, n], squares + x[:, n] ** 2
        found[:, n] = shares.sum(axis=0)
    return found


def two_points(rng: np.random.Generator, runs: int, count: int, p: float) -> Floats:
    """Return values (runs, count) in [0, 1]: 1 with probability p, else 0."""
    return np.where(rng.uniform(size=(runs, count)) < p, 1.0, 0.0)


def squares_of_pairs(x: Floats) -> Floats:
    return np.asarray((x[:, 0::2] - x[:, 1::2]) ** 2)


def is_at_most_one(found: Floats) -> bool:
    """Return whether a mean is at most 1 + 3 standard errors."""
    return bool(found.mean() <= 1 + 3 * found.std() / math.sqrt(len(found)))


def allowed(count: int, delta: float) -> int:
    return int(binom.ppf(0.99, count, delta))


def reached(found: Floats, level: float) -> int:
    """Return the number of runs whose wealth is 1/level after some value."""
    return int(np.count_nonzero(found.max(axis=1) >= 1 / level))


def false_bounds(values: Floats, risk_weight: float, risk: float) -> int:
    """Return the number of runs of which the bound is below the risk after some value."""
    false = 0
    for run in values:
        bound = RiskUpperBound(CLIP, risk_weight, delta=DELTA)
        for value in run:
            bound.add(float(value))
        false += bound.upper < risk  # a running minimum
    return false


def needed(mean: float, sd: float, limit: float, rng: np.random.Generator) -> int:
    """Return the number of rollouts after which a risk is shown to be below a limit."""
    bound = RiskUpperBound(CLIP, 0.2, delta=DELTA)
    while bound.upper >= limit and bound.count < 1_000:
        bound.add(float(np.clip(rng.normal(mean, sd), *CLIP)))
    return bound.count


def test_the_vectorised_rule_is_that_of_the_class() -> None:
    x = np.random.default_rng(1).uniform(0.2, 1.0, size=(5, 30))
    for run, row in zip(x, wealth(x, 2048 / GRID), strict=True):
        sequence, past = BettingSequence((1e-300,)), Past()
        for value in run:
            sequence.observe(float(value), past)
            past.add(float(value))
        assert sequence.wealth()[2048] == pytest.approx(row[-1], rel=1e-9)


@pytest.mark.parametrize("runs", SIZES)
@pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
def test_the_mean_wealth_is_at_most_one(p: float, runs: int) -> None:
    x = two_points(np.random.default_rng(2), runs, 40, p)
    for values, mean in ((1.0 - x, 1.0 - p), (squares_of_pairs(x), 2 * p * (1 - p))):
        found = wealth(values, mean)
        assert is_at_most_one(found[:, -1])
        assert reached(found, DELTA / 2) <= allowed(runs, DELTA / 2)


def test_a_tight_case_is_false_more_often_than_a_tenth_of_delta() -> None:
    x = two_points(np.random.default_rng(3), 5_000, 200, 0.5)
    assert reached(wealth(1.0 - x, 0.5), DELTA / 2) > 5_000 * DELTA / 20
    assert reached(wealth(squares_of_pairs(x), 0.5), DELTA / 2) > 5_000 * DELTA / 20


def test_pairs_that_share_a_rollout_are_caught() -> None:
    x = two_points(np.random.default_rng(4), 20_000, 40, 0.1)
    assert not is_at_most_one(wealth((x[:, 1:] - x[:, :-1]) ** 2, 0.18)[:, -1])


@pytest.mark.parametrize(("p", "risk_weight"), [(0.5, 0.2), (0.1, 5.0), (0.9, 1.0)])
def test_false_bounds_are_as_rare_as_stated(p: float, risk_weight: float) -> None:
    x = two_points(np.random.default_rng(5), 200, 60, p)
    risk = CLIP[0] + WIDTH * (p - risk_weight * math.sqrt(p * (1 - p)))
    assert false_bounds(CLIP[0] + WIDTH * x, risk_weight, risk) <= allowed(200, DELTA)


def test_a_sample_variance_in_place_of_the_bound_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    class Taken(RiskUpperBound):
        """The mistake: the standard deviation of the sample in place of its lower bound."""

        seen: tuple[float, ...] = ()
        least = math.inf

        def add(self, value: float) -> None:
            super().add(value)
            self.seen = (*self.seen, value)
            self.least = min(self.least, super().upper)

        @property
        def deviation(self) -> float:
            return float(np.std(self.seen, ddof=1)) if len(self.seen) > 1 else 0.0

        @property
        def upper(self) -> float:
            return self.least

    monkeypatch.setitem(globals(), "RiskUpperBound", Taken)
    x = two_points(np.random.default_rng(5), 200, 20, 0.1)
    risk = CLIP[0] + WIDTH * (0.1 - 5.0 * 0.3)
    assert false_bounds(CLIP[0] + WIDTH * x, 5.0, risk) > allowed(200, DELTA)


def test_rollouts_that_named_the_start_are_caught() -> None:
    """The worst of 100 starts by its rollouts, all at the limit: their bound is false too often, a fresh one is not."""
    rng, runs = np.random.default_rng(6), 400
    x = two_points(rng, 100 * runs, 12, 0.5).reshape(runs, 100, 12)
    worst = x.mean(axis=2).argmin(axis=1)
    named, fresh = x[np.arange(runs), worst], two_points(rng, runs, 12, 0.5)
    assert reached(wealth(1.0 - named, 0.5), DELTA / 2) > allowed(runs, DELTA)
    assert reached(wealth(1.0 - fresh, 0.5), DELTA / 2) <= allowed(runs, DELTA / 2)


@pytest.mark.parametrize(
    ("deficit", "sd", "most"), [(0.1, 0.03, 20), (0.1, 0.1, 40), (0.1, 0.2, 90), (0.3, 0.03, 9), (0.3, 0.2, 16)]
)
def test_rollouts_that_a_deficit_needs(deficit: float, sd: float, most: int) -> None:
    """Of a share of the clip's range; the median of 25 campaigns."""
    rng, limit = np.random.default_rng(7), 0.5
    mean = limit - deficit * WIDTH + 0.2 * sd
    found = [needed(mean, sd, limit, rng) for _ in range(25)]
    assert most / 3 < np.median(found) <= most

"""Wealth of many runs at once: the rules of the betting bounds a second time, compared with the classes by tests."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaincc, betaln

from perfbound.orchestrator.mathematics.bounds.checks.spot_check import (
    BORROWED,
    CAP,
    DEFICITS,
    EXPLORE,
    OUTSIDE,
    SUSPICIOUS,
)
from perfbound.orchestrator.mathematics.bounds.one_law.betting import BOLD_AND_CAREFUL
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import LEAST_SPREAD, RENEWAL, STRATEGIES
from perfbound.orchestrator.mathematics.bounds.rounding import ROUND_OFF

DELTA = 0.05

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]
Law = Callable[[NDArray[np.int64]], Floats]
"""From the starts that the runs test (R,) to the excesses (R,)."""


class SpotChecks:
    """R spot checks of one noisy hypothesis with limit 0, without tests in flight."""

    def __init__(self, runs: int, size: int, low: float, high: float) -> None:
        self.runs, self.size, self.low = runs, size, low
        self.count, self.mean, self.squares = (np.zeros((runs, size)) for _ in range(3))
        self.within, self.degrees, self.started, self.centre = (np.zeros(runs) for _ in range(4))
        self.between = np.full(runs, ((high - low) / 4) ** 2)
        self.least = 1e-6 * (high - low)
        self.wealth = np.full((len(DEFICITS), runs, size), 1 / len(DEFICITS))
        self.joint = np.full((len(DEFICITS), runs), 1 / len(DEFICITS))
        self.own_peak, self.peak = np.ones((runs, size)), np.ones(runs)

    def sd(self) -> Floats:
        common = (self.within + BORROWED * self.between / (self.started + 1)) / (self.degrees + BORROWED)
        own = (self.squares + BORROWED * common[:, None]) / (np.maximum(self.count - 1, 0) + BORROWED)
        return np.maximum(np.sqrt(own), self.least)

    def choose(self, delta: float) -> tuple[NDArray[np.int64], Marks]:
        """Return the next start of every run, and whether it has one."""
        if (first := int(self.count[0].sum())) < self.size:
            return np.full(self.runs, first), np.ones(self.runs, dtype=bool)
        sd, root = self.sd(), np.sqrt(self.count)
        score = np.where(self.mean + SUSPICIOUS * sd / root > 0, self.mean / sd + EXPLORE / root, -np.inf)
        node = score.argmax(axis=1)
        named = self.own_peak.max(axis=1) >= 2 * self.size * (1 + ROUND_OFF) / delta
        return node, (score[np.arange(self.runs), node] > -np.inf) & ~named

    def add(
        self, node: NDArray[np.int64], excess: Floats, active: Marks, *, factor: float = 1.0, late: bool = False
    ) -> None:
        """Add one rollout of every active run; a `factor` other than 1 is a mistake in the bets, and so is `late`.

        `late`: the product over all starts takes a rollout or leaves it when its value is known.
        """
        at = np.arange(self.runs)[active], node[active]
        e, largest = excess[active], CAP / max(-self.low + OUTSIDE, OUTSIDE)
        sd = self.sd()[at]
        joins = e > 0 if late else (self.count[at] > 0) & (self.mean[at] > 0)
        for s, deficit in enumerate(DEFICITS):
            bet = np.minimum(deficit / (sd * (1 + deficit * deficit)), largest)
            self.wealth[s][at] *= (1 + bet * e) * factor
            self.joint[s][active] *= np.where(joins, (1 + bet * e) * factor, 1.0)
        self.own_peak[at] = np.maximum(self.own_peak[at], self.wealth.sum(axis=0)[at])
        self.peak = np.maximum(self.peak, self.mean_wealth())
        self._take(at, e, active)

    def mean_wealth(self) -> Floats:
        return np.asarray((self.wealth.sum(axis=(0, 2)) / self.size + self.joint.sum(axis=0)) / 2)

    def _take(self, at: tuple[NDArray[np.int64], NDArray[np.int64]], e: Floats, active: Marks) -> None:
        new = self.count[at] == 0
        run = at[0]
        self.degrees[run] += ~new
        self.started[run] += new
        shift = np.where(new, e - self.centre[run], 0.0)
        self.centre[run] += shift / np.maximum(self.started[run], 1)
        self.between[run] += shift * (e - self.centre[run])
        self.count[at] += 1
        shift = e - self.mean[at]
        self.mean[at] += shift / self.count[at]
        square = shift * (e - self.mean[at])
        self.squares[at] += square
        self.within[run] += square


class CvarReading:
    """CVaR with t the sample quantile, of R runs with values in [0, 1]."""

    strategies = STRATEGIES

    def __init__(self, share: float, runs: int) -> None:
        self.share, self.bar = share, np.zeros(runs)

    def renew(self, past: Floats) -> None:
        n = past.shape[1]
        self.bar = np.sort(past, axis=1)[:, max(math.ceil(self.share * n) - 1, 0)]

    def x(self, values: Floats) -> Floats:
        """Return x (R, ..) of values (R, ..)."""
        bar = self.bar.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(bar - np.maximum(bar - values, 0) / self.share)

    def least(self) -> Floats:
        return self.bar - self.bar / self.share


class RiskReading:
    """The linearised risk with c and s from the past, of R runs with values in [0, 1]; r = 0 is the mean."""

    strategies = BOLD_AND_CAREFUL

    def __init__(self, risk_weight: float, delta: float, runs: int) -> None:
        self.risk_weight, self.delta = risk_weight, delta
        self.centre, self.spread = np.full(runs, 0.5), np.full(runs, 0.5)

    def renew(self, past: Floats) -> None:
        self.centre = past.mean(axis=1)
        farther = np.maximum(self.centre, 1 - self.centre)
        least = farther**2 * math.log(1 / self.delta) / past.shape[1]
        self.spread = np.maximum(np.sqrt(past.var(axis=1) + least), LEAST_SPREAD)

    def x(self, values: Floats) -> Floats:
        """Return x (R, ..) of values (R, ..)."""
        c, s = (each.reshape(-1, *[1] * (values.ndim - 1)) for each in (self.centre, self.spread))
        return np.asarray(values - 0.5 * self.risk_weight * ((values - c) ** 2 / s + s))

    def least(self) -> Floats:
        return np.minimum(self.x(np.zeros(len(self.centre))), self.x(np.ones(len(self.centre))))


def predictable_wealth(values: Floats, reading: CvarReading | RiskReading, m: float) -> Floats:
    """Return the wealth at the candidate m after each of the values (R, n) in [0, 1], shape (R, n)."""
    runs, n = values.shape
    wealth = np.repeat([[each.share] for each in reading.strategies], runs, axis=1)
    found = np.empty((runs, n))
    renewal, mean, variance = 1.0, np.zeros(runs), np.zeros(runs)
    for j in range(n):
        x = reading.x(values[:, j])
        if j:
            past = reading.x(values[:, :j])
            mean, variance = past.mean(axis=1), past.var(axis=1)
            room = np.maximum(m - reading.least(), 1e-9)
            for s, strategy in enumerate(reading.strategies):
                edge = np.maximum(mean + strategy.optimism * np.sqrt(variance / j) - m, 0)
                spread = variance + edge * edge
                kelly = np.divide(edge, spread, out=np.zeros(runs), where=spread > 0)
                wealth[s] *= 1 + np.minimum(kelly, strategy.cap / room) * (x - m)
        if j + 1 >= renewal:
            renewal = RENEWAL * (j + 1)
            reading.renew(values[:, : j + 1])
        found[:, j] = wealth.sum(axis=0)
    return found


def cvar_wealth(values: Floats, share: float, m: float) -> Floats:
    """Return the wealth against CVaR <= m after each of the values (R, n) in [0, 1], shape (R, n)."""
    return predictable_wealth(values, CvarReading(share, len(values)), m)


def risk_wealth(values: Floats, risk_weight: float, m: float) -> Floats:
    """Return the wealth against risk <= m after each of the values (R, n) in [0, 1], shape (R, n)."""
    return predictable_wealth(values, RiskReading(risk_weight, DELTA, len(values)), m)


def mixture_wealth(failed: Marks, p: float, *, above: bool = True) -> Floats:
    """Return ln W against P >= p (or P <= p) after each of the samples (R, n), shape (R, n): a second formula.

    With the integrals over theta in place of u, by scipy.special.betaln; a record without a failure has no W below.
    """
    runs, last = failed.shape
    # Many runs share their counts: each pair is computed once.
    pairs, place = np.unique(np.cumsum(failed, axis=1) * (last + 1) + np.arange(1, last + 1), return_inverse=True)
    k, n = np.divmod(pairs.astype(float), last + 1)
    a = k + 0.5 if above else np.maximum(k, 1) - 0.5
    with np.errstate(divide="ignore"):
        tail = np.log((betainc if above else betaincc)(a, n - k + 1, p))
    found = betaln(a, n - k + 1) + tail - math.log(2) - a * math.log(p) - (n - k) * math.log1p(-p)
    return np.asarray(np.where((k > 0) | above, found, -np.inf)[place].reshape(runs, last))

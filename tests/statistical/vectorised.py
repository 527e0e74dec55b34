"""Wealth of many runs at once: the rules of spot check and CVaR a second time, compared with the classes by a test."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.bounds.betting import ROUND_OFF
from perfbound.orchestrator.mathematics.bounds.rollout_spread import BORROWED
from perfbound.orchestrator.mathematics.bounds.share import RENEWAL, STRATEGIES
from perfbound.orchestrator.mathematics.bounds.spot_check import CAP, DEFICITS, EXPLORE, OUTSIDE, SUSPICIOUS

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


def cvar_wealth(values: Floats, share: float, m: float, *, late: bool = False) -> Floats:
    """Return the wealth at the candidate m after each of the values (R, n) in [0, 1], shape (R, n).

    `late` is a mistake: t comes from all values, those to come included.
    """
    runs, n = values.shape
    wealth = np.repeat([[each.share] for each in STRATEGIES], runs, axis=1)
    found = np.empty((runs, n))
    bar, renewal = np.zeros(runs), 1.0
    past = np.zeros((runs, 0))
    final = np.sort(values, axis=1)[:, max(math.ceil(share * n) - 1, 0)]
    for j in range(n):
        if late:
            bar = final
        x = bar - np.maximum(bar - values[:, j], 0) / share
        if j:
            shortfalls = bar[:, None] - np.maximum(bar[:, None] - past, 0) / share
            mean, variance = shortfalls.mean(axis=1), shortfalls.var(axis=1)
            room = np.maximum(m - (bar - bar / share), 1e-9)
            for s, strategy in enumerate(STRATEGIES):
                edge = np.maximum(mean + strategy.optimism * np.sqrt(variance / j) - m, 0)
                spread = variance + edge * edge
                kelly = np.divide(edge, spread, out=np.zeros(runs), where=spread > 0)
                wealth[s] *= 1 + np.minimum(kelly, strategy.cap / room) * (x - m)
        past = values[:, : j + 1]
        if j + 1 >= renewal:
            renewal = RENEWAL * (j + 1)
            bar = np.sort(past, axis=1)[:, max(math.ceil(share * (j + 1)) - 1, 0)]
        found[:, j] = wealth.sum(axis=0)
    return found

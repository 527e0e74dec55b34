"""Bets on the rollouts of a design: the martingales of the bound, and that of the audit of B, also with a control.

| symbol | name     | meaning                                                              | shape  | unit   |
|--------|----------|----------------------------------------------------------------------|--------|--------|
| x_i    |          | points of the design                                                 | (q, p) | -      |
| n_i    | `counts` | rollouts that are planned at x_i                                     | (q,)   | -      |
| s      | `spread` | guess of the standard deviation of a rollout; decides no validity    | ()     | unit X |
| g      |          | what the control explains of a rollout; its mean given the start is 0 | ()    | unit X |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...control.sequence import EXPECTED, SLACK, Control, ControlSequence, Disturbed, first_fit
from ...gp.kernels import Floats, scaled
from ...gp.lattice import Lattice
from ...gp.radial import Radial
from .audit import NormAudit, PointMeans
from .bound import GuessedMean, KrigingBounds, KrigingPremises
from .cells import NodeCells, between
from .weights import WeightTerms, plan_weights


@dataclass(frozen=True)
class Kernels:
    """The points of a design (q, p) on a lattice, and the kernel between them and the nodes, (m, q), (q, q)."""

    lattice: Lattice
    radial: Radial
    points: Floats
    to_nodes: Floats
    inner: Floats

    @classmethod
    def of(cls, lattice: Lattice, radial: Radial, points: Floats) -> "Kernels":
        """Compute the kernel."""
        return cls(lattice, radial, points, between(radial, lattice.nodes, points), between(radial, points, points))

    @property
    def cell(self) -> float:
        """The norm of the difference of the kernel at two opposite corners of a cell."""
        diagonal = scaled(np.array([self.lattice.spacing]), self.radial.axes)
        return self.radial.distance(float(np.sqrt(np.sum(diagonal**2))))

    @property
    def shares(self) -> Floats:
        """The points as shares of the ranges, from -1 to 1, (q, p)."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        found: Floats = (2.0 * self.points - low - high) / np.where(high > low, high - low, 1.0)
        return found


class Bets:
    """The bets of one plan."""

    def __init__(self, kernels: Kernels, premises: KrigingPremises, counts: Floats, spread: float) -> None:
        self.kernels, self.premises, self.counts, self.spread = kernels, premises, counts, spread
        self.means = PointMeans(kernels.inner, premises, spread)
        self._audit = NormAudit(self.means, counts, premises, spread)
        self.lower, self.beyond_ball = premises.without_data, False

    @cached_property
    def bounds(self) -> KrigingBounds:
        """The martingales of the bound."""
        # The plan of the weights takes a second, and no proposal waits for it: the workers have their tests by then.
        kernels = self.kernels
        cells = NodeCells(kernels.lattice, kernels.radial, kernels.points)
        weights, _ = self.planned(self.spread, self.premises.ends)
        return KrigingBounds(weights, kernels.inner, cells, self.premises, error=kernels.radial.error)

    def replan(self, spread: float, weights: Floats, means: PointMeans) -> None:
        """Continue with other weights, for another noise; `means` are those of the rollouts so far, less that noise.

        All are functions of the rollouts before, so that the martingales stay what they are.
        """
        self.spread, self.means = spread, means
        self.bounds.plan(weights)
        self._audit.plan(means, spread)

    def planned(self, spread: float, ends: tuple[float, float]) -> tuple[Floats, float]:
        """Return weights for rollouts with this noise and range, and the most that a node is expected to lose."""
        terms = _weight_terms(self.premises, spread, ends, self.kernels.cell)
        found, losses = plan_weights(self.kernels.to_nodes, self.kernels.inner, self.counts, terms)
        return found, float(losses.max())

    @property
    def b_min(self) -> float:
        """The norm that the rollouts need, by the audit."""
        return self._audit.b_min

    @property
    def is_refuted(self) -> bool:
        """Whether the rollouts contradict B."""
        return self.beyond_ball or self.b_min > self.premises.rkhs_norm

    def observe(self, point: int, values: Sequence[float], ends: tuple[float, float] | None = None) -> None:
        """Bet on the rollouts of one test; with a control `values` are X - g, in `ends`."""
        self._audit.observe(point, values, ends)  # before the means: its bets are functions of the tests before
        self.bounds.observe(point, values, ends)
        self.means.add(point, values)
        found = self.bounds.minimum()
        # mu exceeds m0 + B nowhere, so that a bound there contradicts B as well.
        self.beyond_ball = self.beyond_ball or found >= self.premises.prior_mean + self.premises.rkhs_norm
        if not self.is_refuted:  # false premises prove nothing: the bound from before is kept
            self.lower = found


class ControlledBets:
    """Bets on X - g, from which a control has taken what declared disturbances explain.

    Until its first fit, and where that explains nothing, X itself is bet on.
    """

    def __init__(self, bets: Bets, disturbed: Disturbed) -> None:
        self.bets, self._scores, self._shares = bets, disturbed.scores, bets.kernels.shares
        first = first_fit(int(bets.counts.sum()))
        parameters = self._shares.shape[1]
        self._controls = ControlSequence(disturbed.bases, parameters, bets.premises.ends, first)
        self._first: list[tuple[int, Floats, Floats, Floats]] = []
        """Point, start, scores and X of the tests before the first fit."""
        self._tests = self.before_fit = 0
        self._is_used = True

    @property
    def control(self) -> Control | None:
        """The control of the next rollouts; None before the first fit, and where none explains enough."""
        return self._controls.control if self._is_used else None

    def observe(self, point: int, values: Sequence[float], reported: Floats) -> None:
        """Bet on the rollouts of one test, before the control sees them; `reported` (b, m) as of `Disturbed`."""
        if not self._is_used:
            self.bets.observe(point, values)
            return
        x, scores = np.array(values), self._scores(self._tests, reported)
        starts = np.repeat(self._shares[[point]], len(x), axis=0)
        self._bet(point, starts, scores, x)
        if not self._controls.has_begun:
            self._first.append((point, starts, scores, x))
            self.before_fit += len(x)
        self._controls.add(point, starts, scores, x)
        self._tests += 1
        if self._first and self._controls.has_begun:
            self._begin()

    def _bet(self, point: int, starts: Floats, scores: Floats, x: Floats) -> None:
        if self.control is None:
            self.bets.observe(point, x.tolist(), self.bets.premises.ends)
            return
        low, high = self.bets.premises.ends
        g, least, most = self.control.values(starts, scores)
        slack = SLACK * (high - low)
        self.bets.observe(point, (x - g).tolist(), (low - float(most[0]) - slack, high - float(least[0]) + slack))

    def _begin(self) -> None:
        """Plan the further weights for the noise that the control leaves, if it is expected to pay."""
        if (control := self.control) is not None:
            # Three digits: the plan of the weights is then the same on every CPU.
            before, spread = _rounded(control.before), _rounded(EXPECTED * control.residual)
            _, least, most = control.values(self._shares, np.zeros((len(self._shares), len(control.bases))))
            low, high = self.bets.premises.ends
            weights, loss = self.bets.planned(spread, (_rounded(low - float(most.max())), high - _rounded(least.min())))
            # What it takes out it adds to the range, and with few rollouts the range costs more than the noise.
            self._is_used = loss < self.bets.planned(before, (low, high))[1]
            if self._is_used:
                means = PointMeans(self.bets.kernels.inner, self.bets.premises, spread)
                for point, starts, scores, x in self._first:
                    means.add(point, (x - control.values(starts, scores)[0]).tolist())
                self.bets.replan(spread, weights, means)
        self._first.clear()


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _weight_terms(premises: KrigingPremises, spread: float, ends: tuple[float, float], cell: float) -> WeightTerms:
    # Before any rollout the guess of its mean is m0.
    u, (low, high) = GuessedMean(premises).value, ends
    least = 1e-3 * (high - low)
    return WeightTerms(premises.rkhs_norm, premises.delta, spread, max(u - low, least), max(high - u, least), cell)

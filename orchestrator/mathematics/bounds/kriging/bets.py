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

from ...control.sequence import Control, ControlSequence, Disturbed, first_fit
from ...gp.kernels import Floats
from ...gp.lattice import Lattice
from ...gp.radial import Radial
from .audit import NormAudit, PointMeans
from .bound import GuessedMean, KrigingBounds, KrigingPremises
from .cells import NodeCells, between
from .weights import WeightTerms, plan_weights

SLACK = 1e-12
"""Of a range, by which the sums of a control may be rounded."""
EXPECTED = 0.6
"""Of the noise that the first fit leaves, what later ones leave; 1.2 lost 0.004 of the bound of 1,000 rollouts."""


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
        kernels, terms = self.kernels, _weight_terms(self.premises, self.spread)
        planned = plan_weights(kernels.to_nodes, kernels.inner, self.counts, terms)
        cells = NodeCells(kernels.lattice, kernels.radial, kernels.points)
        return KrigingBounds(planned, kernels.inner, cells, self.premises, error=kernels.radial.error)

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

    The rollouts before its first fit serve that alone: they vary so much more than the later ones that no weight is
    right for both. Where a fit explains nothing, X itself is bet on.
    """

    def __init__(self, bets: Bets, disturbed: Disturbed) -> None:
        self.bets, self._scores, self._shares = bets, disturbed.scores, bets.kernels.shares
        first = first_fit(int(bets.counts.sum()))
        parameters = self._shares.shape[1]
        self._controls = ControlSequence(disturbed.bases, parameters, bets.premises.ends, first)
        self._first: list[tuple[int, Floats, Floats, Floats]] = []
        """Point, start, scores and X of the tests before the first fit."""
        self._tests = self.before_fit = 0

    @property
    def control(self) -> Control | None:
        """The control of the next rollouts; None before the first fit, and where none explains anything."""
        return self._controls.control

    def observe(self, point: int, values: Sequence[float]) -> None:
        """Take the rollouts of one test; from the first fit on, bet on them before the control sees them."""
        x, scores = np.array(values), self._scores(self._tests)
        starts = np.repeat(self._shares[[point]], len(x), axis=0)
        if self._controls.has_begun:
            self._bet(point, starts, scores, x)
        else:
            self._first.append((point, starts, scores, x))
            self.before_fit += len(x)
            self.bets.means.add(point, values)
        self._controls.add(starts, scores, x)
        self._tests += 1
        if self._first and self._controls.has_begun:
            self._begin()

    def _bet(self, point: int, starts: Floats, scores: Floats, x: Floats) -> None:
        control = self._controls.control
        if control is None:
            self.bets.observe(point, x.tolist())
            return
        g, least, most = control.values(starts, scores)
        low, high = self.bets.premises.ends
        slack = SLACK * (high - low)
        self.bets.observe(point, (x - g).tolist(), (low - float(most[0]) - slack, high - float(least[0]) + slack))

    def _begin(self) -> None:
        """Plan for the rollouts after the first fit, whose noise is what the control leaves."""
        control, before = self._controls.control, self.bets
        # Three digits: the plan of the weights is then the same on every CPU.
        spread = before.spread if control is None else float(f"{EXPECTED * control.residual:.3g}")
        counts = before.counts.copy()
        for point, _, _, x in self._first:
            counts[point] = max(counts[point] - len(x), 0.0)
        self.bets = Bets(before.kernels, before.premises, counts, spread)
        for point, starts, scores, x in self._first:
            rest = x if control is None else x - control.values(starts, scores)[0]
            self.bets.means.add(point, rest.tolist())
        self._first.clear()


def _weight_terms(premises: KrigingPremises, spread: float) -> WeightTerms:
    # Before any rollout the guess of its mean is m0.
    u, (low, high) = GuessedMean(premises).value, premises.ends
    least = 1e-3 * (high - low)
    return WeightTerms(premises.rkhs_norm, premises.delta, spread, max(u - low, least), max(high - u, least))

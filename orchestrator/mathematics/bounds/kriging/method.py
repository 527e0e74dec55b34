"""Method `kriging`: an upper bound of max J over a box, valid at every moment, from weighted sums of rollouts.

| symbol | name         | meaning                                                           | shape | unit   |
|--------|--------------|-------------------------------------------------------------------|-------|--------|
| J      |              | maximised objective: the mean of the values of single rollouts    |       | unit J |
| X      |              | minus the value of a rollout; mu = -J is bounded from below       | ()    | unit J |
| m0     | `prior_mean` | the norm bound is about J - m0                                    | ()    | unit J |
| B      | `rkhs_norm`  | bound of the norm of J - m0                                       | ()    | unit J |
|        | `ends`       | range of the value of one rollout                                 | (2,)  | unit J |
| s      | `spread`     | guess of the standard deviation of a rollout; decides no validity | ()    | unit J |
| delta  | `delta`      | failure probability                                               | ()    | -      |

The design, its order and the weights follow from the budget, before the first rollout. There is no lower bound of
max J: the rollouts are where the upper one needs them, and not where J is largest, so a lower bound would tend to
something else than J* and no tolerance could end the campaign. The budget ends it, or the audit of B.

With declared disturbances a control takes out what they explain: X - g has the mean of X, and less variance. The first
rollouts serve its first fit, and no bound rests on them: the weights are planned for the noise that is left.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .....schemas.values import Band, Bound, Observation, Proposal
from ...control.sequence import ControlSequence, Disturbed, first_fit
from ...gp.kernels import Floats, Matern
from ...gp.lattice import Lattice
from ...gp.points import point_at
from ...gp.radial import Radial
from ..method import Integers, Method
from .audit import NormAudit, PointMeans
from .bound import GuessedMean, KrigingBounds, KrigingPremises, check_values
from .cells import NodeCells, between
from .design import plan_design
from .forecast import PlannedBounds
from .weights import WeightTerms, plan_weights

SLACK = 1e-12
"""Of a range, by which sums of a control may be rounded."""
SPREAD_MARGIN = 1.2
"""A larger spread loses less than one that is too small."""


@dataclass(frozen=True, slots=True)
class KrigingBudget:
    """What is planned beforehand: `tests` of `replicates` rollouts each, `points` points per parameter."""

    tests: int
    replicates: int
    points: int


class KrigingMethod(Method):
    """The fixed tests of one problem, and its bound after every test.
    Implements eq. (kriging) of [PB].

    `premises` are those of J and of the value of a rollout.

    Raises ValueError at construction for parameters outside their range.

    >>> from perfbound.orchestrator.mathematics.gp.lattice import Lattice
    >>> method = KrigingMethod(
    ...     Lattice((0.0,), (1.0,), 5), Matern(2.5, 2.0), KrigingPremises(0.3, -0.6, (-1.0, 0.0), 0.05), spread=0.1,
    ...     budget=KrigingBudget(30, 10, 3))
    >>> for _ in range(30):
    ...     bound = method.observe(method.propose(), Observation(-0.7, (-0.6, -0.8) * 5))
    >>> bound.lower, bound.verdict, round(bound.upper, 3)
    (None, None, -0.652)

    """

    def __init__(
        self,
        lattice: Lattice,
        kernel: Matern,
        premises: KrigingPremises,
        *,
        spread: float,
        budget: KrigingBudget,
        disturbed: Disturbed | None = None,
    ) -> None:
        if not (math.isfinite(spread) and spread > 0):
            raise ValueError(f"spread must be a positive finite number, not {spread!r}")
        self._radial, self._spread = Radial(kernel), spread
        self.lattice, self.design = lattice, plan_design(lattice, budget.tests, budget.points)
        low, high = premises.ends
        # From here on everything is about X: J is maximised, so its mirror is bounded from below.
        self._premises = KrigingPremises(premises.rkhs_norm, -premises.prior_mean, (-high, -low), premises.delta)
        self._points = lattice.nodes[list(self.design.nodes)]
        self._places = {node: i for i, node in enumerate(self.design.nodes)}
        self._to_nodes = between(self._radial, lattice.nodes, self._points)
        self._inner = between(self._radial, self._points, self._points)
        self._counts = np.array(self.design.counts, dtype=np.float64) * budget.replicates
        self._means = PointMeans(self._inner, self._premises, spread)
        self._audit = NormAudit(self._means, self._counts, self._premises, spread)
        self._tests, self.beyond_ball, self._upper = 0, False, -self._premises.without_data
        self._disturbed, self._training = disturbed, _Training([])
        if disturbed is not None:
            middle, half = (
                0.5 * (self._points.max(axis=0) + self._points.min(axis=0)),
                0.5 * np.ptp(self._points, axis=0),
            )
            self._shares = (self._points - middle) / np.where(half > 0, half, 1.0)
            first = first_fit(budget.tests * budget.replicates)
            self._controls = ControlSequence(disturbed.bases, lattice.dimension, self._premises.ends, first)

    @cached_property
    def _bounds(self) -> KrigingBounds:
        # The plan of the weights takes a second, and no proposal waits for it: the workers have their tests by then.
        terms = _weight_terms(self._premises, self._spread)
        planned = plan_weights(self._to_nodes, self._inner, self._counts, terms)
        cells = NodeCells(self.lattice, self._radial, self._points)
        return KrigingBounds(planned, self._inner, cells, self._premises, error=self._radial.error)

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.lattice.size

    @property
    def probability(self) -> float:
        """1 - delta."""
        return 1.0 - self._premises.delta

    @property
    def b_min(self) -> float:
        """The norm that the rollouts need, by the audit, at a failure probability delta of its own."""
        return self._audit.b_min

    @property
    def coming(self) -> PlannedBounds:
        """The rest of the plan, for forecasts."""
        return PlannedBounds(self._bounds, self._means, self._counts)

    def outlook(self, more: float) -> tuple[Floats, Floats] | None:
        """Return the `PlannedBounds.outlook`; None before every point was tested: nothing is known there."""
        if np.any((self._counts > 0) & (self._means.counts == 0)):
            return None
        return self.coming.outlook(more)

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:  # noqa: ARG002
        """Return the next test of the design; it changes nothing, and `first` has no effect here.

        Raises:
            ValueError: the design has no more tests.

        """
        return self.proposal_at(self.design.nodes_of(self._tests + len(pending), 1)[0], pending)

    def propose_each(self, tests: int, pending: int) -> tuple[Integers, Floats]:
        """Return the next tests of the design; raises as `propose`."""
        nodes = self.design.nodes_of(self._tests + pending, tests)
        return np.array(nodes, dtype=np.int64), np.array([point_at(self.lattice, node) for node in nodes])

    def acquisition(self, pending: Sequence[int]) -> Floats:
        """Return 1 at the next node of the design and 0 elsewhere (m,): no rule may choose another one."""
        chosen = np.zeros(self.size)
        chosen[self.propose(pending=pending).node] = 1.0
        return chosen

    def proposal_at(self, index: int, pending: Sequence[int]) -> Proposal:  # noqa: ARG002
        """Return the proposal of a node."""
        return Proposal(index, point_at(self.lattice, index), None, None, None, None)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:  # noqa: ARG002
        """Return None: the design follows from whole numbers, which no CPU rounds differently."""
        return None

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the rollouts of one test and return the bound; on an error nothing changes.

        Raises:
            ValueError: there is no value, one is outside its range, or the node is no point of the design.

        """
        return self.bound_after([(proposal, observation)])

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Add the rollouts of k tests and return the bound; raises as `observe`.

        The bound of a cell is the largest one after any test, and a refutation keeps the bound before it: both need the
        bounds of all cells after each test, O(m (q + s)) a test and O(m) a rollout whatever k is.
        """
        self.recall_each(nodes, y, each)
        return self.bound_after([])

    def bound_after(self, tests: Sequence[tuple[Proposal, Observation]]) -> Bound:
        """Add observations, and return the bound that follows from all of them; raises as `observe`."""
        self.recall(tests)
        return Bound(self._upper, None, "refuted" if self._is_refuted else None)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations; raises as `observe`, and then nothing changes."""
        self._add([(proposal.node, [-value for value in observation.each]) for proposal, observation in tests])

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:  # noqa: ARG002
        """Add observations; raises as `observe`, and then nothing changes."""
        self._add(list(zip(nodes.tolist(), (-each).tolist(), strict=True)))

    def band(self, bound: Bound) -> Band:
        """Return the band: for all nodes at once at 1 - delta, each cell at delta/#nodes, from the rollouts so far.

        So its worst value is not below the bound of the maximum, which needs no union over nodes. The mean is the
        interpolant of the means at the points (kriging). A node has no lower bound, and no node is excluded.
        """
        mean = -(self._premises.prior_mean + self._to_nodes @ self._means.roughness())
        each = self._bounds.current(self._premises.cost + math.log(self.size) * (1.0 + 1e-14))
        upper = np.full(self.size, math.nan) if bound.verdict == "refuted" else -each
        nothing = np.full(self.size, math.nan)
        return Band(tuple(mean.tolist()), tuple(nothing.tolist()), tuple(upper.tolist()), possible=(True,) * self.size)

    def _add(self, tests: Sequence[tuple[int, Sequence[float]]]) -> None:
        """Add tests, each with its node and the values of X."""
        for node, values in tests:
            if node not in self._places:
                raise ValueError(f"node {node} is no point of the design")
            if not values:
                raise ValueError("a test needs at least one rollout")
            check_values(values, self._premises.ends)
        for node, values in tests:
            if self._disturbed is None:
                self._bet(self._places[node], values)
            else:
                self._bet_without_disturbances(self._places[node], np.array(values), self._disturbed)
            self._tests += 1

    def _bet(self, point: int, values: Sequence[float], ends: tuple[float, float] | None = None) -> None:
        """Bet on the rollouts of one test; with a control `values` are X - g, in `ends`."""
        self._audit.observe(point, values, ends)  # before the means: its bets are functions of the tests before
        self._bounds.observe(point, values, ends)
        self._means.add(point, values)
        found = self._bounds.minimum()
        # mu exceeds m0 + B nowhere, so that a bound there contradicts B as well.
        self.beyond_ball = self.beyond_ball or found >= self._premises.prior_mean + self._premises.rkhs_norm
        if not self._is_refuted:  # false premises prove nothing: the bound from before is kept
            self._upper = -found

    def _bet_without_disturbances(self, point: int, x: Floats, disturbed: Disturbed) -> None:
        """Bet on what the disturbances leave of the rollouts of one test, and then show them to the control."""
        starts, scores = np.repeat(self._shares[[point]], len(x), axis=0), disturbed.scores(self._tests)
        control, low, high = self._controls.control, *self._premises.ends
        if not self._controls.fits:
            self._training.rollouts.append((point, starts, scores, x))
            self._means.add(point, x.tolist())
        elif control is None:
            self._bet(point, x.tolist())
        else:
            g, least, most = control.values(starts, scores)
            slack = SLACK * (high - low)
            self._bet(point, (x - g).tolist(), (low - float(most[0]) - slack, high - float(least[0]) + slack))
        before = self._controls.fits
        self._controls.add(starts, scores, x)
        if self._controls.fits and not before:
            self._begin()

    def _begin(self) -> None:
        """Plan for the rollouts after the first fit, whose noise is what the control has left."""
        control = self._controls.control
        if control is not None:
            # Three digits: the plan of the weights is then the same on every CPU.
            self._spread = float(f"{SPREAD_MARGIN * control.residual:.3g}")
        self._means = PointMeans(self._inner, self._premises, self._spread)
        for point, starts, scores, x in self._training.rollouts:
            self._counts[point] = max(self._counts[point] - len(x), 0.0)
            known = x if control is None else x - control.values(starts, scores)[0]
            self._means.add(point, known.tolist())
        self._audit = NormAudit(self._means, self._counts, self._premises, self._spread)
        self._training.rollouts.clear()
        self.__dict__.pop("_bounds", None)  # a forecast may have planned already

    @property
    def _is_refuted(self) -> bool:
        return self.beyond_ball or self.b_min > self._premises.rkhs_norm


class _Training(NamedTuple):
    """The rollouts before the first fit of a control."""

    rollouts: list[tuple[int, Floats, Floats, Floats]]
    """Point, start, scores and X of those of each test."""


def _weight_terms(premises: KrigingPremises, spread: float) -> WeightTerms:
    # Before any rollout the guess of its mean is m0.
    u, (low, high) = GuessedMean(premises).value, premises.ends
    least = 1e-3 * (high - low)
    return WeightTerms(premises.rkhs_norm, premises.delta, spread, max(u - low, least), max(high - u, least))

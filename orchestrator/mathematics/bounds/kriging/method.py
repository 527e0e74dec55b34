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

With declared disturbances a control takes out what they explain: X - g has the mean of X, and less variance. After its
first fit the weights are planned anew, for the noise that is left.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .....schemas.values import Band, Bound, Observation, Proposal
from ...control.sequence import Control, Disturbed
from ...gp.kernels import Floats, Matern
from ...gp.lattice import Lattice
from ...gp.points import point_at
from ...gp.radial import Radial
from ..method import Integers, Method
from .bets import Bets, ControlledBets, Kernels
from .bound import KrigingPremises, check_values
from .design import plan_design
from .forecast import PlannedBounds


@dataclass(frozen=True, slots=True)
class KrigingBudget:
    """What is planned beforehand: `tests` of `replicates` rollouts each, at `points`^p points at most."""

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
    (None, None, -0.655)

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
        lengths = np.broadcast_to(kernel.length_scale, lattice.dimension).tolist()
        self.lattice, self.design = lattice, plan_design(lattice, budget.tests, budget.points, lengths)
        low, high = premises.ends
        # From here on everything is about X: J is maximised, so its mirror is bounded from below.
        self._premises = KrigingPremises(premises.rkhs_norm, -premises.prior_mean, (-high, -low), premises.delta)
        self._places = {node: i for i, node in enumerate(self.design.nodes)}
        self._kernels = Kernels.of(lattice, Radial(kernel), lattice.nodes[list(self.design.nodes)])
        counts = np.array(self.design.counts, dtype=np.float64) * budget.replicates
        bets, self._disturbed = Bets(self._kernels, self._premises, counts, spread), disturbed
        self._betting = bets if disturbed is None else ControlledBets(bets, disturbed)
        self._tests = 0

    @property
    def bets(self) -> Bets:
        """The bets so far; with a control those after its first fit."""
        return self._betting if isinstance(self._betting, Bets) else self._betting.bets

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self.lattice.size

    @property
    def probability(self) -> float:
        """1 - delta."""
        return 1.0 - self._premises.delta

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the rollouts before its first fit; None where there is none."""
        bets = self._betting
        if isinstance(bets, Bets) or bets.control is None:
            return None
        return bets.control, bets.before_fit

    @property
    def coming(self) -> PlannedBounds:
        """The rest of the plan, for forecasts."""
        return PlannedBounds(self.bets.bounds, self.bets.means, self.bets.counts)

    def outlook(self, more: float) -> tuple[Floats, Floats] | None:
        """Return the `PlannedBounds.outlook`; None before every point was tested: nothing is known there."""
        if np.any((self.bets.counts > 0) & (self.bets.means.counts == 0)):
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
        return Bound(-self.bets.lower, None, "refuted" if self.bets.is_refuted else None)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations; raises as `observe`, and then nothing changes."""
        self._add([(proposal.node, observation.each) for proposal, observation in tests])

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:  # noqa: ARG002
        """Add observations; raises as `observe`, and then nothing changes."""
        self._add(list(zip(nodes.tolist(), each.tolist(), strict=True)))

    def band(self, bound: Bound) -> Band:
        """Return the band: for all nodes at once at 1 - delta, each cell at delta/#nodes, from the rollouts so far.

        So its worst value is not below the bound of the maximum, which needs no union over nodes. The mean is the
        interpolant of the means at the points (kriging). A node has no lower bound, and no node is excluded.
        """
        mean = -(self._premises.prior_mean + self._kernels.to_nodes @ self.bets.means.roughness())
        each = self.bets.bounds.current(self._premises.cost + math.log(self.size) * (1.0 + 1e-14))
        upper = np.full(self.size, math.nan) if bound.verdict == "refuted" else -each
        nothing = np.full(self.size, math.nan)
        return Band(tuple(mean.tolist()), tuple(nothing.tolist()), tuple(upper.tolist()), possible=(True,) * self.size)

    def _add(self, tests: Sequence[tuple[int, Sequence[float]]]) -> None:
        """Add tests, each with its node and its contributions."""
        pieces = [self._split(each) for _, each in tests]
        for (node, _), (values, _) in zip(tests, pieces, strict=True):
            if node not in self._places:
                raise ValueError(f"node {node} is no point of the design")
            if not values:
                raise ValueError("a test needs at least one rollout")
            check_values(values, self._premises.ends)
        for (node, _), (values, reported) in zip(tests, pieces, strict=True):
            if isinstance(self._betting, ControlledBets):
                self._betting.observe(self._places[node], values, reported)
            else:
                self._betting.observe(self._places[node], values)
            self._tests += 1

    def _split(self, each: Sequence[float]) -> tuple[list[float], Floats]:
        """Return X of the rollouts of a test (b,), and what they report (b, m)."""
        values, reported = each, np.empty((len(each), 0))
        if self._disturbed is not None and self._disturbed.reported:
            (row,), (reported,) = self._disturbed.split(np.array([each]))
            values = row.tolist()
        return [-value for value in values], reported

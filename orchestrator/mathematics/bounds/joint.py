"""Several methods on one sequence of tests: each has its own objective J_i, and the largest of them is bounded.

| symbol  | name    | meaning                                              | shape | unit    |
|---------|---------|------------------------------------------------------|-------|---------|
| J       |         | max_i J_i, the objective of the whole                | ()    | unit J  |
| U_i     | `upper` | bound of max J_i, each with its own 1 - delta        | ()    | unit J  |
| alpha_i |         | tolerance of J_i: its method stops at U_i - L_i <= alpha_i | () | unit J |

P[max J > max_i U_i] <= delta without a division of delta: were max J above every U_i, the method of the one fixed i
with the largest max J_i would be wrong [B82]. Every method takes every observation: its bound is valid for each rule
that chooses a test from the observations before it, and so for tests that another method chose.
"""

import math
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, Verdict
from ..gp.acquisition import maximiser, rival_node
from ..gp.kernels import Floats
from .method import Integers, Method

PIECE = 2**12
"""Tests that are Python objects at a time, of half a kilobyte each."""


class SharedMethod(Method, Protocol):
    """A method whose next test may be chosen together with others."""

    def acquisition(self, pending: Sequence[int]) -> Floats:
        """Return how large J may be at each candidate (m,), which its own rule maximises."""
        ...

    def proposal_at(self, index: int, pending: Sequence[int]) -> Proposal:
        """Return the proposal of a candidate that another rule chose."""
        ...


Part = TypeVar("Part", bound=SharedMethod)


class JointMethod(Method, Generic[Part]):
    """The methods of several objectives, which observe the same tests and take turns in proposing them.

    The method whose bounds are furthest apart in units of its tolerance leads; where it is nearly as well served, the
    test is where the others are open too. `split` returns the observation of each objective, `nodes` are the candidates
    (m, p) that all methods share.
    Implements eq. (several) of [PB].
    """

    def __init__(
        self,
        parts: Sequence[Part],
        alphas: Sequence[float],
        split: Callable[[Observation], Sequence[Observation]],
        nodes: Floats,
    ) -> None:
        if not parts or len(parts) != len(alphas):
            raise ValueError(f"needs one tolerance for each of its methods, not {len(alphas)} for {len(parts)}")
        self.parts, self._alphas, self._split, self._nodes = tuple(parts), tuple(alphas), split, nodes
        self.bounds = (Bound(None, None, None),) * len(self.parts)
        """The last bound of each method."""

    @property
    def size(self) -> int:
        """Number of candidates, which all methods share."""
        return self.parts[0].size

    @property
    def probability(self) -> float:
        """The least of the probabilities of its methods."""
        return min(part.probability for part in self.parts)

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:
        """Return the test that is best for the method with the furthest way to go, and good for the others.

        Formula: argmax over the candidates of a_l(z) + alpha_l mean_i (a_i(z) - L_i)^+ / alpha_i, a the acquisition
        functions, l the lead, i over the other methods that have not stopped. It changes nothing; it raises as they do.
        """
        lead, values = self._lead, self._acquisition(pending)
        if first is not None or not math.isfinite(values.max()):
            return self.parts[lead].propose(first, pending)
        return self.parts[lead].proposal_at(maximiser(values), pending)

    def propose_each(self, tests: int, pending: int) -> tuple[Integers, Floats]:
        """Return the next tests, which are the same for every method whose tests no observation decides."""
        return self.parts[0].propose_each(tests, pending)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU could have chosen it as maximiser."""
        lead, values = self._lead, self._acquisition(pending)
        if not math.isfinite(values.max()):
            return self.parts[lead].rival(x, pending)
        index = rival_node(values, self._nodes, x)
        return None if index is None else self.parts[lead].proposal_at(index, pending)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Give every method its observation, and return the bound of the largest objective.

        A method that has converged goes on observing; the end is that of the last one.
        """
        each = self._split(observation)
        self.bounds = tuple(part.observe(proposal, own) for part, own in zip(self.parts, each, strict=True))
        return joined(self.bounds)

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Give every method its observations of k tests, and return the bound of the largest objective."""
        found = zip(self.parts, self._split_each(y, each), strict=True)
        self.bounds = tuple(part.observe_each(nodes, *own) for part, own in found)
        return joined(self.bounds)

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:
        """Give every method its observations of k tests, whose bounds are known."""
        for part, own in zip(self.parts, self._split_each(y, each), strict=True):
            part.recall_each(nodes, *own)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Give every method its observations, whose bounds are known."""
        each = [self._split(observation) for _, observation in tests]
        for place, part in enumerate(self.parts):
            part.recall([(proposal, own[place]) for (proposal, _), own in zip(tests, each, strict=True)])

    def band(self, bound: Bound) -> Band:
        """Return the band of the largest objective; `bound` is its own."""
        found = [part.band(bound) for part in self.parts]
        mean, lower, upper = (
            tuple(np.max([getattr(band, name) for band in found], axis=0).tolist())
            for name in ("mean", "lower", "upper")
        )
        # Its maximum is that of some objective, so it is where the maximum of one of them may be.
        return Band(mean, lower, upper, tuple(map(any, zip(*(band.possible for band in found), strict=True))))

    def _split_each(self, y: Floats, each: Floats) -> list[tuple[Floats, Floats]]:
        """Return the observations (k,) of every method, and the contributions (k, b) to them."""
        own: list[list[tuple[Floats, Floats]]] = [[] for _ in self.parts]
        for first in range(0, len(y), PIECE):
            rows = zip(y[first : first + PIECE].tolist(), each[first : first + PIECE].tolist(), strict=True)
            tests = [self._split(Observation(value, tuple(row))) for value, row in rows]
            for pieces, observations in zip(own, zip(*tests, strict=True), strict=True):
                pieces.append((np.array([one.y for one in observations]), np.array([one.each for one in observations])))
        return [
            (np.concatenate([values for values, _ in pieces]), np.concatenate([rows for _, rows in pieces]))
            for pieces in own
        ]

    @property
    def _lead(self) -> int:
        """The place of the method that is furthest from its end."""
        return max(range(len(self.parts)), key=lambda place: (self._distance(place), -place))

    def _acquisition(self, pending: Sequence[int]) -> Floats:
        """Return the sum that the next test maximises (m,), in the unit of the J of the lead."""
        lead = self._lead
        # By turns of the lead alone three requirements took 1.09 in place of 0.95 times the tests of the hardest.
        gains = [
            np.maximum(part.acquisition(pending) - bound.lower, 0.0) / alpha
            for place, (part, bound, alpha) in enumerate(zip(self.parts, self.bounds, self._alphas, strict=True))
            if place != lead and bound.verdict is None and bound.lower is not None
        ]
        values = self.parts[lead].acquisition(pending)
        return values + self._alphas[lead] * np.mean(gains, axis=0) if gains else values

    def _distance(self, place: int) -> float:
        """Return how far a method is from its end, in units of its tolerance; negative after it."""
        bound = self.bounds[place]
        if bound.verdict is not None:
            return -1.0
        if bound.upper is None or bound.lower is None:
            return math.inf
        return (bound.upper - bound.lower) / self._alphas[place]


def joined(bounds: Sequence[Bound]) -> Bound:
    """Return the bound of the largest of several objectives; its verdict is None until each has one.

    >>> joined([Bound(0.5, 0.4, "converged"), Bound(0.7, 0.1, None)])
    Bound(upper=0.7, lower=0.4, verdict=None)
    """
    upper = [each.upper for each in bounds if each.upper is not None]
    lower = [each.lower for each in bounds if each.lower is not None]
    verdicts = [each.verdict for each in bounds]
    verdict: Verdict | None = "refuted" if "refuted" in verdicts else "converged"
    return Bound(
        max(upper) if len(upper) == len(bounds) else None,
        max(lower, default=None),
        None if None in verdicts else verdict,
    )

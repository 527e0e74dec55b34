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
from typing import Generic, TypeVar

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, Verdict
from .method import Method

Part = TypeVar("Part", bound=Method)


class JointMethod(Method, Generic[Part]):
    """The methods of several objectives, which observe the same tests and take turns in proposing them.

    The next test is that of the method whose bounds are furthest apart in units of its tolerance, so that tests go
    where the end of the campaign needs them. `split` returns the observation of each objective.
    Implements eq. (several) of [PB].
    """

    def __init__(
        self,
        parts: Sequence[Part],
        alphas: Sequence[float],
        split: Callable[[Observation], Sequence[Observation]],
    ) -> None:
        if not parts or len(parts) != len(alphas):
            raise ValueError(f"needs one tolerance for each of its methods, not {len(alphas)} for {len(parts)}")
        self.parts, self._alphas, self._split = tuple(parts), tuple(alphas), split
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
        """Return the test of the method whose turn it is; it changes nothing."""
        return self._next.propose(first, pending)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) of the method whose turn it is."""
        return self._next.rival(x, pending)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Give every method its observation, and return the bound of the largest objective.

        A method that has converged goes on observing; the end is that of the last one.
        """
        each = self._split(observation)
        self.bounds = tuple(part.observe(proposal, own) for part, own in zip(self.parts, each, strict=True))
        return joined(self.bounds)

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

    @property
    def _next(self) -> Part:
        return self.parts[max(range(len(self.parts)), key=lambda place: (self._distance(place), -place))]

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

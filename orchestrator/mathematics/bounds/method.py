"""Port of the three methods: the next test, and the bound of max J that the observations so far prove."""

from collections.abc import Sequence
from typing import Protocol

from ....schemas.values import Band, Bound, Observation, Proposal


class Method(Protocol):
    """One problem's method, all in terms of the maximised objective J; observations enter in test order.

    The state is a function of the observations alone: the same ones in the same order rebuild it to the bit.
    """

    @property
    def size(self) -> int:
        """Number of candidates."""
        ...

    @property
    def probability(self) -> float:
        """Probability with which the bound is valid, before its outward rounding."""
        ...

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:
        """Return the next test, given the candidates of the tests in flight (`pending`); it changes nothing.

        `first` is the candidate of a problem's first test, given then and only then.
        """
        ...

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU, which rounds differently, could have chosen it."""
        ...

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add an observation, and return the bound that follows from all of them; on an error nothing changes."""
        ...

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known; afterwards `band` is current, and a stored bound may not be."""
        ...

    def band(self, bound: Bound) -> Band:
        """Return the band over the candidates after at least one observation; `bound` followed from the last one."""
        ...

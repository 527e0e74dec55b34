"""Port of the three methods: the next test, and the bound of max J that the observations so far prove."""

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ....schemas.values import Band, Bound, Observation, Proposal
from ..gp.kernels import Floats

Integers = NDArray[np.int64]


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

    def propose_each(self, tests: int, pending: int) -> tuple[Integers, Floats]:  # noqa: ARG002
        """Return candidates (k,) and starts (k, p) of the next k tests, after those in flight; it changes nothing.

        Raises:
            TypeError: the method chooses each test by the observations before it.

        """
        raise TypeError(f"{type(self).__name__} chooses each test by the observations before it")

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU, which rounds differently, could have chosen it."""
        ...

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add an observation, and return the bound that follows from all of them; on an error nothing changes."""
        ...

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Add the observations of k tests in their order; return the bound after the last one.

        `nodes` (k,) are their candidates, `y` (k,) the observations, and `each` (k, b) the contributions of the
        replicates, equally many for each test; k is at least 1. State and bounds are to the bit those of `observe`,
        test by test; on an error nothing changes.

        What is here is for methods that choose each test from the observations before it: one test after the other,
        where an error leaves those before it.
        """
        bound = Bound(None, None, None)
        for proposal, observation in _tests(nodes, y, each):
            bound = self.observe(proposal, observation)
        return bound

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known; afterwards `band` is current, and a stored bound may not be."""
        ...

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:
        """Add observations as `observe_each`, whose bounds are known, as `recall`."""
        self.recall(list(_tests(nodes, y, each)))

    def band(self, bound: Bound) -> Band:
        """Return the band over the candidates after at least one observation; `bound` followed from the last one."""
        ...


def _tests(nodes: Integers, y: Floats, each: Floats) -> Iterator[tuple[Proposal, Observation]]:
    for node, value, contributions in zip(nodes.tolist(), y.tolist(), each.tolist(), strict=True):
        yield Proposal(node, (), None, None, None, None), Observation(value, tuple(contributions))

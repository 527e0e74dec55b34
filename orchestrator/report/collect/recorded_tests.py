"""The tests of a problem as the database has them: a block stays one fact, and numbers of all tests are columns."""

from bisect import bisect_right, insort
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....schemas.result.block_facts import BlockObservationFact, BlockProposalFact
from ....schemas.result.facts import BoundFact, ObservationFact, ProposalFact
from ....schemas.values import Observation, Proposal
from ...store.facts import ObservedTest

Floats = NDArray[np.float64]
Proposed = ProposalFact | BlockProposalFact
Observed = ObservationFact | BlockObservationFact


class ProposedTests:
    """The proposals of a problem or closing check, by their tests."""

    def __init__(self) -> None:
        self._facts: dict[int, Proposed] = {}
        """By the first test of each."""
        self._firsts: list[int] = []
        self._number = 0

    def __len__(self) -> int:
        """Return the number of tests."""
        return self._number

    def add(self, fact: Proposed) -> None:
        """Add the next proposal, of a test or of a block."""
        insort(self._firsts, fact.test)
        self._facts[fact.test] = fact
        self._number += len(fact)

    def fact(self, test: int) -> Proposed | None:
        """Return the proposal of a test, or of its block; None where there is none."""
        place = bisect_right(self._firsts, test)
        found = self._facts[self._firsts[place - 1]] if place else None
        return found if found is not None and test < found.test + len(found) else None

    def block(self, first: int) -> BlockProposalFact:
        """Return the proposal of the block that begins with a test.

        Raises:
            KeyError: there is none.

        """
        found = self._facts[first]
        if not isinstance(found, BlockProposalFact):
            raise KeyError(first)
        return found

    def proposal(self, test: int) -> Proposal:
        """Return the proposal of a test.

        Raises:
            KeyError: there is none.

        """
        match self.fact(test):
            case ProposalFact(proposal=found):
                return found
            case BlockProposalFact() as block:
                return block.of_test(test).proposal
            case None:
                raise KeyError(test)

    def start(self, test: int) -> tuple[float, ...] | None:
        """Return z of a test; None where it is not proposed."""
        return None if self.fact(test) is None else self.proposal(test).x


class ObservedTests:
    """The tests of a problem that have a bound, in their order; one is joined from its facts when it is asked for.

    The columns `x` (n, p), `y` (n,) and `each` (n, w) have the start, the observation and the contributions of its
    replicates of every test; a row of `each` ends with NaN where another test has more. They are not to be changed.
    """

    def __init__(self, proposed: ProposedTests) -> None:
        self._proposed = proposed
        self._bounds: list[BoundFact] = []
        self._ends: list[int] = []
        """The number of tests after each bound."""
        self._x, self._y, self._each = _Rows(), _Rows(), _Rows()

    def __len__(self) -> int:
        """Return the number of tests."""
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, test: int) -> ObservedTest:
        """Return a test by its number."""
        number = range(len(self))[test]
        bound, each = self._bounds[bisect_right(self._ends, number)], self._each.values[number]
        return ObservedTest(
            number,
            self._proposed.proposal(number),
            Observation(float(self._y.values[number, 0]), tuple(each[~np.isnan(each)].tolist())),
            bound.bound,
            bound.stopped_by if bound.test == number else None,
        )

    @property
    def last(self) -> ObservedTest | None:
        """The last test; None before the first."""
        return self[-1] if self._ends else None

    @property
    def x(self) -> Floats:
        """The start of each test, shape (n, p)."""
        return self._x.values

    @property
    def y(self) -> Floats:
        """The observation of each test, shape (n,)."""
        return self._y.values.reshape(-1)

    @property
    def each(self) -> Floats:
        """The contributions of the replicates of each test, shape (n, w)."""
        return self._each.values

    def of_replicates(self, number: int) -> Iterator[list[float]]:
        """Yield the first so many contributions to each test, or all that it has."""
        return (row[~np.isnan(row)].tolist() for row in self.each[:, :number])

    def add(self, observed: Iterable[Observed], bound: BoundFact) -> None:
        """Add the observations since the last bound, and the one that follows from them."""
        for fact in observed:
            proposed = self._proposed.fact(fact.test)
            match proposed, fact:
                case ProposalFact(), ObservationFact():
                    x, y = np.array([proposed.proposal.x]), np.array([[fact.observation.y]])
                    each = np.array([fact.observation.each]).reshape(1, -1)
                case BlockProposalFact(), BlockObservationFact() if len(proposed) == len(fact):
                    x, y, each = proposed.x, fact.y.reshape(-1, 1), fact.contributions
                case _:
                    raise ValueError(f"test {fact.test} of {fact.problem} is not proposed as it is observed")
            self._x.add(x)
            self._y.add(y)
            self._each.add(each)
        if len(self._y.values) != bound.test + 1:
            raise ValueError(f"the bound after test {bound.test} of {bound.problem} has other observations")
        self._bounds.append(bound)
        self._ends.append(bound.test + 1)

    def extend(self) -> None:
        """Let the last test be no end any more: the problem has a larger budget."""
        self._bounds[-1] = replace(self._bounds[-1], budget=False)


class _Rows:
    """Rows of numbers (n, w) that grow; a shorter one ends with NaN."""

    def __init__(self) -> None:
        self._room, self._number = np.empty((0, 0)), 0

    @property
    def values(self) -> Floats:
        """All rows."""
        return self._room[: self._number]

    def add(self, rows: Floats) -> None:
        """Add rows."""
        number, (length, width) = self._number + len(rows), self._room.shape
        if number > length or rows.shape[1] > width:
            # Twice the room, so that a row is copied few times however many there will be.
            wider = np.full((max(number, 2 * length if number > length else length), max(width, rows.shape[1])), np.nan)
            wider[: self._number, :width] = self.values
            self._room = wider
        self._room[self._number : number, : rows.shape[1]] = rows
        self._number = number

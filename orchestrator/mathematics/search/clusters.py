"""Clusters of failing starts: which of the failures that a search has found are different ones.

| symbol | name       | meaning                                                              | shape | unit      |
|--------|------------|----------------------------------------------------------------------|-------|-----------|
| u      |            | a start as shares of the ranges                                      | (p,)  | 1         |
| l, h   |            | ends of the smallest box around the starts of a cluster              | (p,)  | 1         |
| d(u)   | `distance` | root of the mean over parameters of (max(l - u, 0) + max(u - h, 0))^2 | ()    | 1         |
|        | `violated` | numbers of the parts of the formula that are below 0                 | tuple | -         |

A failing start is of a cluster with the same violated parts if d(u) is at most `NEAR`, or if the start in the middle
between it and the nearest one of the cluster fails with them as well. Where neither holds, it begins a cluster.

The middle is what makes this work with many parameters. Two failures of one kind agree in the few parameters that
matter, and are far apart in the others: so does the middle, and fails. The box then grows along the others at once,
and stays narrow along those that matter, so that a search that keeps out of it leaves the kind.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..gp.kernels import Floats

Point = tuple[float, ...]
Middle = Callable[[Point, Point], Point | None]
"""The start that can be tested next to the middle between two; None where there is none."""
NEAR = 0.1
"""Distance up to which a start belongs to a box, as a share of the ranges."""
Named = TypeVar("Named")
"""What a caller has of a test: its rollout."""


@dataclass(frozen=True, slots=True)
class Failure(Generic[Named]):
    """A failing test: its start, the parts of the formula that it violates, and its robustness, below 0."""

    start: Point
    violated: tuple[int, ...]
    margin: float
    test: Named


@dataclass(slots=True)
class Cluster(Generic[Named]):
    """Failures of one kind, the first one first."""

    failures: list[Failure[Named]]

    @property
    def violated(self) -> tuple[int, ...]:
        """The parts that all of them violate."""
        return self.failures[0].violated

    @property
    def worst(self) -> Failure[Named]:
        """The one of least robustness, of equal ones the first."""
        return min(self.failures, key=lambda each: each.margin)

    @property
    def box(self) -> tuple[Point, Point]:
        """Ends of the smallest box around the starts."""
        starts = np.array([each.start for each in self.failures])
        return tuple(starts.min(axis=0).tolist()), tuple(starts.max(axis=0).tolist())


@dataclass(slots=True)
class _Waiting(Generic[Named]):
    """A failure that may be of some clusters."""

    failure: Failure[Named]
    middles: dict[int, Point | None] = field(default_factory=dict)
    """What decides, by the place of the cluster; chosen once, because a cluster grows while a test is in flight."""


@dataclass(slots=True)
class Clusters(Generic[Named]):
    """The clusters of the failing tests of a box, fed with every test in order; not thread-safe.

    A function of the tests alone: the same ones in the same order give the same clusters.

    >>> found = Clusters((0.0,), (1.0,), lambda one, other: ((one[0] + other[0]) / 2,))
    >>> found.observe((0.1,), -1.0, (), "a")
    >>> found.observe((0.9,), -2.0, (), "b")
    >>> len(found.found), found.middles
    (1, [(0.5,)])
    >>> found.observe((0.5,), 1.0, (), "c")
    >>> [each.worst.test for each in found.found]
    ['a', 'b']

    """

    low: Point
    high: Point
    middle: Middle = field(compare=False)
    found: list[Cluster[Named]] = field(default_factory=list)
    _waiting: list[_Waiting[Named]] = field(default_factory=list)
    _violated: dict[Point, tuple[int, ...] | None] = field(default_factory=dict)
    """Of every start that was tested; None where it passes."""

    @property
    def undecided(self) -> int:
        """Failing tests of which it is open whether they are of a cluster."""
        return len(self._waiting)

    @property
    def middles(self) -> list[Point]:
        """The starts to test next, which decide for each such test whether it is of a cluster."""
        return [middle for each in self._waiting if (middle := self._open(each)) is not None]

    def observe(self, start: Point, margin: float, violated: tuple[int, ...], test: Named) -> None:
        """Take a test."""
        fails = margin < 0.0
        self._violated[start] = violated if fails else None
        self._settle()
        if fails:
            self._waiting.append(_Waiting(Failure(start, violated, margin, test)))
            self._settle()

    def near(self, starts: Floats) -> NDArray[np.bool_]:
        """Whether each of some starts (m, p) is in, or next to, the box of a cluster."""
        known = np.zeros(len(starts), dtype=np.bool_)
        for each in self.found:
            known |= self._distances(each, starts) <= NEAR
        return known

    def _settle(self) -> None:
        """Decide what is known of the failures that wait; one that joins a cluster may show where others belong."""
        number = -1
        while number != len(self._waiting):
            number = len(self._waiting)
            for each in tuple(self._waiting):
                self._decide(each)

    def _decide(self, waiting: _Waiting[Named]) -> None:
        """Give a failure to a cluster, or begin one with it, as soon as either is known."""
        for place in self._places(waiting.failure):
            joins = self._is_of(waiting, place)
            if joins is None:
                return
            if joins:
                self.found[place].failures.append(waiting.failure)
                break
        else:
            self.found.append(Cluster([waiting.failure]))
        self._waiting.remove(waiting)

    def _is_of(self, waiting: _Waiting[Named], place: int) -> bool | None:
        """Whether a failure is of a cluster; None where that is open."""
        failure, cluster = waiting.failure, self.found[place]
        if self._distances(cluster, np.array([failure.start]))[0] <= NEAR:
            return True
        if place not in waiting.middles:
            nearest = self._nearest(cluster, failure.start)
            middle = self.middle(failure.start, nearest)
            # Nothing is between them.
            if middle in (failure.start, nearest):
                return True
            waiting.middles[place] = middle
        middle = waiting.middles[place]
        if middle is None:  # no test is possible there, as outside of a region
            return False
        if middle not in self._violated:
            return None
        # A failure in the middle that is of another cluster shows nothing.
        others = (each.start for number, one in enumerate(self.found) if number != place for each in one.failures)
        return self._violated[middle] == failure.violated and middle not in others

    def _open(self, waiting: _Waiting[Named]) -> Point | None:
        """Return the start that decides next about a failure; None without one."""
        untested = (each for each in waiting.middles.values() if each is not None and each not in self._violated)
        return next(untested, None)

    def _places(self, failure: Failure[Named]) -> list[int]:
        """Return the places of the clusters with the same violated parts, the nearest first."""
        start = np.array([failure.start])
        of_parts = [place for place, each in enumerate(self.found) if each.violated == failure.violated]
        return sorted(of_parts, key=lambda place: float(self._distances(self.found[place], start)[0]))

    def _nearest(self, cluster: Cluster[Named], start: Point) -> Point:
        starts = [each.start for each in cluster.failures]
        squares = np.sum((self._unit(np.array(starts)) - self._unit(np.array([start]))) ** 2, axis=1)
        return starts[int(np.argmin(squares))]

    def _distances(self, cluster: Cluster[Named], starts: Floats) -> Floats:
        """Return the distance of each start (m, p) from the box of a cluster, shape (m,)."""
        low, high = self._unit(np.array(cluster.box))
        units = self._unit(starts)
        beyond = np.maximum(low - units, 0.0) + np.maximum(units - high, 0.0)
        return np.asarray(np.sqrt(np.mean(beyond**2, axis=1)), dtype=np.float64)

    def _unit(self, starts: Floats) -> Floats:
        low, high = np.array(self.low), np.array(self.high)
        # Ends of a range that are equal: a parameter that never changes.
        return np.asarray((starts - low) / np.where(high > low, high - low, 1.0), dtype=np.float64)


def violated_parts(margin: float, parts: Sequence[float]) -> tuple[int, ...]:
    """Return the numbers of the parts that are below 0 where the formula fails; none of a formula of one part.

    >>> violated_parts(-1.0, (2.0, -1.0, -0.5)), violated_parts(1.0, (2.0, -1.0))
    ((1, 2), ())
    """
    return tuple(number for number, part in enumerate(parts) if part < 0.0) if margin < 0.0 else ()

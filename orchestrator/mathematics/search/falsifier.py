"""Falsification: tests that look for any start with a robustness below 0, one proposal at a time.

| test                                     | its start                                                               |
|------------------------------------------|-------------------------------------------------------------------------|
| every `random_every`-th                  | of a scrambled Sobol sequence: a wrong model cannot blind the search    |
| 0, and those before any observation      | of another such sequence                                                |
| 1, where there are inputs over time      | a corner, at which inputs stay for long                                 |
| 2                                        | the middle of the box                                                   |
| while most tests have the least value    | of a third such sequence, every eighth with shapes, see `candidates`    |
| the others                               | of an arm of `portfolio`: mostly the best of many candidates for models |

Deviation: nothing here is a bound, and no claim follows from a search. Claims use the constants of the campaign, or
random starts alone.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..gp.kernels import Floats
from .candidates import BEST, PARENTS, Inputs, Shape, choices_among, cornered, nearby, shaped
from .goal import ALONE, Goal
from .models import LARGEST, Models, Score
from .portfolio import Arm, Portfolio, gain

Point = tuple[float, ...]
Admitted = Callable[[Floats], NDArray[np.bool_]]
"""Whether each of some points (m, p) of the box may be proposed."""
TIE = 0.05
"""Relative difference of an acquisition function that another machine may see."""
BLOCK = 1024
"""Points of a Sobol sequence; the next ones are of a sequence of its own."""
ROUNDS = (0.1, 0.03, 0.01)
"""Steps around the best candidates, in length scales."""
MIDDLE = 2
"""Number of the test in the middle of the box; later ones have arms."""
SHAPED_EVERY = 8
"""While nothing leads anywhere: a failure likes neither ends nor the inside of ranges, as far as is known."""
APART = 0.01
"""Least distance of a choice from each test in flight, in the range of some parameter."""
SHAPES = 64
"""Starts of which the first admitted one is taken."""
MODEL, SOBOL, FIRST, FLAT, SHAPED, ARM = range(6)
"""Streams of random numbers."""


class Falsifier:
    """A search over a box, fed with tests and their robustness; not thread-safe.

    Points that are not `admitted` are not chosen by the model, unless it finds no other; starts that no model chooses
    may be such points. `signals` are the parameters of each input over time, in the order of its knots. Of a `goal`
    with several parts each has a model, which is fed with the robustness of that part.

    A proposal is a function of the seed, of the observations in their order and of the tests in flight: on one machine
    the same ones give the same bits. Its test number is that of the observations and the tests in flight together.

    Raises:
        ValueError: the box is empty, not finite, or has ends of different lengths; `random_every` is below 1.

    >>> search = Falsifier((0.0, -1.0), (10.0, 1.0), seed=1)
    >>> start = search.propose()
    >>> search.observe(start, 2.5)
    >>> search.propose() == search.propose()
    True

    """

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        *,
        seed: int,
        random_every: int = 4,
        admitted: Admitted | None = None,
        signals: Sequence[Sequence[int]] = (),
        goal: Goal = ALONE,
    ) -> None:
        self._low, self._high = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
        if self._low.ndim != 1 or self._low.shape != self._high.shape or not len(self._low):
            raise ValueError(f"box {list(low)} to {list(high)}: give one low and one high end per parameter")
        if not np.all(np.isfinite(self._high - self._low) & (self._low < self._high)):
            raise ValueError(f"box {list(low)} to {list(high)}: every low end must be below its high end, both finite")
        if random_every < 1:
            raise ValueError(f"random_every must be at least 1, not {random_every}")
        self._seed, self._random_every, self._admitted = seed, random_every, admitted
        self._inputs = Inputs(len(self._low), signals)
        self._models = Models(len(self._low), goal)
        self._arms = Portfolio([seed, ARM], self._models.parts)
        self._sobol: dict[int, tuple[int, Floats]] = {}

    @property
    def observations(self) -> int:
        """Number of observations."""
        return len(self._models.points)

    def is_random(self, test: int) -> bool:
        """Whether test `test` is a start of the Sobol sequence, whatever was observed."""
        return (test + 1) % self._random_every == 0

    def propose(self, pending: Sequence[Point] = ()) -> Point:
        """Return the next test (p,), given the tests in flight, which it does not repeat."""
        test = self.observations + len(pending)
        unit = self._without_model(test)
        return self._point(self._by_model(test, [self._unit(each) for each in pending]) if unit is None else unit)

    def is_as_good(self, point: Point, proposal: Point, pending: Sequence[Point] = ()) -> bool:
        """Whether another machine, which rounds differently, could have chosen `point` in place of the proposal.

        Rounding grows in the fit of the length scales and decides between candidates of almost equal value, so that
        the points may be far apart while the acquisition function is about the same.
        """
        test = self.observations + len(pending)
        if self._without_model(test) is not None:
            return point == proposal
        score, _ = self._score(test, [self._unit(each) for each in pending])
        own, other = score(np.stack([self._unit(proposal), self._unit(point)])).tolist()
        return bool(other >= own - TIE * max(1.0, abs(own)))

    def observe(self, point: Point, value: float, parts: Sequence[float] = ()) -> None:
        """Add the robustness of a test, and that of each part of a goal with several; on an error nothing changes.

        Raises:
            ValueError: the point has another number of parameters or is outside the box, or `value` is not finite.

        """
        at = np.array(point, dtype=np.float64)
        if at.shape != self._low.shape or not np.all((at >= self._low) & (at <= self._high)):
            raise ValueError(f"point {point} is not in the box {self._low.tolist()} to {self._high.tolist()}")
        if len(parts) != (self._models.parts if self._models.parts > 1 else 0):
            raise ValueError(f"{len(parts)} values of parts for a goal of {self._models.parts}")
        if not all(map(math.isfinite, (value, *parts))):
            raise ValueError(f"the robustness of {point} is {value}; a search needs finite numbers, clip it")
        # The arm by the tests before this one, as when it was proposed: but for what tests in flight then changed.
        if (test := self.observations) > MIDDLE and not self.is_random(test) and not self._models.flat:
            self._arms.observe(self._arms.arm(test), gain(min(self._models.robustness), value))
        self._models.observe(self._unit(point), parts or (value,), value)

    def _without_model(self, test: int) -> Floats | None:
        """Return the start of a test that is no choice of a model; None of one that is."""
        # Without these the search took twice as many tests to find narrow needles, plateaus and jumps.
        if self.is_random(test):
            return self._sobol_point(SOBOL, test // self._random_every)
        if test == 1 and self._inputs.over_time:
            return self._shaped(test, cornered)
        if not test or not self.observations:
            return self._sobol_point(FIRST, test)
        if self._models.flat:
            if test % SHAPED_EVERY == 0:
                return self._shaped(test, shaped)
            # Numbered one by one: every fourth number of such a sequence alone leaves parts of the box empty.
            before = sum(each % SHAPED_EVERY > 0 and not self.is_random(each) for each in range(test))
            return self._sobol_point(FLAT, before)
        if test == MIDDLE:
            return np.full(len(self._low), 0.5)
        return self._of_arm(test)

    def _of_arm(self, test: int) -> Floats | None:
        match self._arms.arm(test):
            case Arm.ANYWHERE:
                return self._sobol_point(FIRST, test)
            case Arm.SHAPED:
                return self._shaped(test, shaped if test % 2 else cornered)
        return None

    def _shaped(self, test: int, shape: Shape) -> Floats:
        rng = np.random.default_rng([self._seed, SHAPED, test])
        return np.asarray(self._inside(shape(rng, SHAPES, self._inputs))[0], dtype=np.float64)

    def _by_model(self, test: int, pending: list[Floats]) -> Floats:
        score, lengths = self._score(test, pending)
        rng = np.random.default_rng([self._seed, MODEL, test])
        worst = np.argsort(self._models.robustness, kind="stable")[:PARENTS]
        found = choices_among(rng, np.array([self._models.points[each] for each in worst]), self._inputs)
        found = _apart(self._inside(found), pending)
        for step in ROUNDS:
            best = found[np.argsort(-score(found), kind="stable")[:BEST]]
            found = _apart(self._inside(nearby(rng, best, step * np.minimum(lengths, 1.0))), pending)
        return np.asarray(found[np.argmax(score(found))], dtype=np.float64)

    def _score(self, test: int, pending: list[Floats]) -> tuple[Score, Floats]:
        return self._models.scores(self._arms.arm(test), pending)

    def _inside(self, found: Floats) -> Floats:
        """Return the admitted ones of some points (m, p) of the unit box; all of them if there are none."""
        if self._admitted is None:
            return found
        inside = self._admitted(self._low + found * (self._high - self._low))
        return found[inside] if inside.any() else found

    def _sobol_point(self, stream: int, number: int) -> Floats:
        from scipy.stats import qmc  # noqa: PLC0415  (a second of start-up that few commands need)

        block, row = divmod(number, BLOCK)
        if self._sobol.get(stream, (-1, None))[0] != block:
            rng = np.random.default_rng([self._seed, stream, block])
            self._sobol[stream] = block, qmc.Sobol(len(self._low), rng=rng).random(BLOCK)
        return np.asarray(self._sobol[stream][1][row], dtype=np.float64)

    def _point(self, unit: Floats) -> Point:
        # Rounding may leave the box by one unit in the last place.
        return tuple(np.clip(self._low + unit * (self._high - self._low), self._low, self._high).tolist())

    def _unit(self, point: Point) -> Floats:
        return np.asarray((np.array(point) - self._low) / (self._high - self._low), dtype=np.float64)


def _apart(found: Floats, pending: Sequence[Floats]) -> Floats:
    """Return those of some points (m, p) that are apart from the tests in flight in some parameter; all if none is."""
    # Where a model is sure of a failure in flight, nothing else leads away from it: it would be asked for again.
    apart = np.ones(len(found), dtype=np.bool_)
    for each in pending[-LARGEST:]:
        apart &= np.max(np.abs(found - each), axis=1) > APART
    return found[apart] if apart.any() else found

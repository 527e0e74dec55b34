"""The likeliest failure: from a point at which a system fails to a failing one of least |t|, by further tests.

| symbol | name      | meaning                                                                  | shape | unit |
|--------|-----------|--------------------------------------------------------------------------|-------|------|
| x      | `point`   | parameters, of which some are scores of disturbances                     | (n,)  | any  |
| t      |           | these scores: the density of independent normal ones falls with abs(t)   | (k,)  | sd   |
| y      | `margin`  | robustness at a point; a failure is one below 0                          | ()    | any  |
| g      | `slopes`  | differences of y over a step of each parameter                           | (n,)  | -    |

A round tries a step of each score towards 0, and of the other parameters inwards. Where the system still fails, the
step is made as long as it can be: this finds corners, in which two disturbances have to be large at once. Where no step
fails, the differences are slopes, and the next point is that of least |t| on the plane y = 0, the step of the method of
Hasofer, Lind, Rackwitz and Fiessler; other parameters move down the slope. The way to a point that passes is halved.

Basic arithmetic and square roots alone: the points are equal on all machines, to the last bit.
"""

import math
from collections.abc import Generator, Iterator, Sequence

Point = tuple[float, ...]
Tests = Generator[Point, tuple[Point, float], None]
"""Yields the next test and is sent the point that was tested, which may be a rounded one, with its margin."""
STEP = 0.1
"""Of a score in sd."""
SHARE = 0.02
"""Of the range of another parameter."""
CLOSE, FIRST_CLOSE = 0.01, 0.16
"""sd to which a border is found: at last, and at first, for exact ones far from the goal are no help."""
ROUND_OFF = 1e-9
"""Of a score, below which it is 0."""
LEAST_TRUST = 0.02
"""The search ends where so short a part of a step makes nothing better."""


class Likeliest:
    """The search from a failing point of a box (n,), of which `scored` are the scores; not thread-safe.

    `best` is the failing point of least distance so far, which the tests of `tests` improve.

    >>> found = Likeliest((0.5, 3.0, 3.0), -1.0, (0.0, -5.0, -5.0), (1.0, 5.0, 5.0), scored=(1, 2))
    >>> tests = found.tests()
    >>> point = next(tests)
    >>> for _ in range(60):
    ...     try:
    ...         point = tests.send((point, 3.0 - point[1]))
    ...     except StopIteration:
    ...         break
    >>> round(found.distance, 1), round(abs(found.best[2]), 1)
    (3.0, 0.0)

    """

    def __init__(
        self, point: Point, margin: float, low: Sequence[float], high: Sequence[float], scored: Sequence[int]
    ) -> None:
        self.best, self._margin = point, margin
        self._low, self._high, self._scored = tuple(low), tuple(high), tuple(scored)
        self._close = FIRST_CLOSE
        self._others = [j for j in range(len(point)) if j not in self._scored and low[j] < high[j]]

    @property
    def distance(self) -> float:
        """Distance of the best point from the medians of the disturbances, in sd."""
        return self._length(self.best)

    def tests(self) -> Tests:
        """Yield the tests, one after the other."""
        yield from self._between(self._moved(dict.fromkeys(self._scored, 0.0)))
        trust = 1.0
        while trust > LEAST_TRUST and self.distance > CLOSE:
            before, slopes = self.distance, {}
            base, margin = self.best, self._margin
            for j, end in self._ends():
                step = self._step(j, end)
                at = self._stepped(base, j, step)
                if at == base:
                    continue
                tested, value = yield at
                if tested[j] != base[j]:
                    slopes[j] = (value - margin) / (tested[j] - base[j])
                # A failure at a smaller score: as far as it goes.
                if value < 0.0 and self.best == base and self._length(tested) < self.distance:
                    self._take(tested, value)
                    yield from self._between(self._with(tested, j, 0.0))
            if self.distance >= before - self._close:
                yield from self._towards(self._on_plane(base, margin, slopes, trust))
            if self.distance >= before - self._close:
                trust = trust / 2
                self._close = max(self._close / 4, CLOSE)
            else:
                trust = min(2 * trust, 1.0)

    def _towards(self, target: Point) -> Tests:
        """Test a target; where it passes, points of its direction that are as far out as the best one, or nearer."""
        tested, value = yield target
        if value < 0.0 and self._length(tested) < self.distance:
            self._take(tested, value)
            yield from self._between(self._moved(dict.fromkeys(self._scored, 0.0)))
            return
        far = self._length(target)
        if not far or far >= self.distance:
            return
        # Outwards, to just below the distance of the best point: then there is a border between the two.
        stretch = (self.distance - self._close / 2) / far
        outer, value = yield self._moved({j: stretch * target[j] for j in self._scored}, target)
        if value < 0.0 and self._length(outer) < self.distance:
            self._take(outer, value)
            yield from self._between(target)
        else:
            yield from self._between(target)

    def _between(self, passing: Point) -> Tests:
        """Halve the way from the best point to one that is assumed to pass, and take every failure on it."""
        start, low, high = self.best, 0.0, 1.0
        length = math.sqrt(sum((a - b) ** 2 for a, b in zip(start, passing, strict=True)))
        while (high - low) * length > self._close:
            middle = (low + high) / 2
            at = tuple(a + middle * (b - a) for a, b in zip(start, passing, strict=True))
            tested, value = yield at
            if value < 0.0:
                low = middle
                if self._length(tested) < self.distance:
                    self._take(tested, value)
            else:
                high = middle

    def _on_plane(self, base: Point, margin: float, slopes: dict[int, float], trust: float) -> Point:
        """Return the point of least |t| at which the plane through the differences is 0, a share `trust` of the way."""
        changed = {
            j: min(max(base[j] - math.copysign(trust * 0.25 * self._width(j), slopes[j]), self._low[j]), self._high[j])
            for j in self._others
            if slopes.get(j)
        }
        level = margin + sum(slopes[j] * (changed[j] - base[j]) for j in changed)
        level -= sum(slopes.get(j, 0.0) * base[j] for j in self._scored)
        square = sum(slopes.get(j, 0.0) ** 2 for j in self._scored)
        for j in self._scored:
            wanted = -slopes.get(j, 0.0) * level / square if level > 0.0 and square else 0.0
            nearer = base[j] + trust * (min(max(wanted, self._low[j]), self._high[j]) - base[j])
            changed[j] = nearer if abs(nearer) > ROUND_OFF else 0.0
        return self._moved(changed)

    def _ends(self) -> Iterator[tuple[int, float]]:
        """Yield each parameter with the value that a step goes to: 0 of a score, else the farther end."""
        for j in self._scored:
            yield j, 0.0
        for j in self._others:
            yield j, self._low[j] if self.best[j] - self._low[j] > self._high[j] - self.best[j] else self._high[j]

    def _step(self, j: int, end: float) -> float:
        size = STEP if j in self._scored else SHARE * self._width(j)
        there = end - self.best[j]
        # A score that is next to 0 has a slope as well.
        if j in self._scored and abs(there) < size:
            return size if there <= 0.0 else -size
        return math.copysign(min(size, abs(there)), there)

    def _take(self, point: Point, margin: float) -> None:
        self.best, self._margin = point, margin

    def _width(self, j: int) -> float:
        return self._high[j] - self._low[j]

    def _length(self, point: Point) -> float:
        return math.sqrt(sum(point[j] ** 2 for j in self._scored))

    @staticmethod
    def _with(point: Point, j: int, value: float) -> Point:
        return (*point[:j], value, *point[j + 1 :])

    def _stepped(self, base: Point, j: int, step: float) -> Point:
        return self._with(base, j, base[j] + step)

    def _moved(self, values: dict[int, float], point: Point | None = None) -> Point:
        return tuple(values.get(j, each) for j, each in enumerate(self.best if point is None else point))

"""Falsification: tests that look for any start with a robustness below 0, one proposal at a time.

Test 0 is the middle of the box. Every `random_every`-th test is a start of a scrambled Sobol sequence, whatever the
model says: a wrong kernel cannot blind the search. The others maximise, in turn, one of two acquisition functions of a
Gaussian process (`surrogate`) over candidates (`candidates`):

| function                                  | when         | purpose                                           |
|-------------------------------------------|--------------|---------------------------------------------------|
| (t - mu)/sigma, as P(z < t) grows with it | two of three | far from 0 it explores, near 0 it goes there      |
| E max(min z - Z, 0), Z ~ N(mu, sigma^2)   | one of three | leads downwards where a jump hides the way to 0 |

Deviation: neither is a bound, and no claim follows from a search. Claims use the constants of the campaign, or random
starts alone.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from ..gp.kernels import Floats
from .surrogate import Surrogate, fitted, prior_mode
from .warp import warped

# Points of the unit box among which a search chooses: everywhere, on its faces, and around its worst starts.

WIDE, FACES, NEAR, SNAPPED = 256, 192, 64, 24
"""Points in the whole box, on its faces, and of each worst start: around it, and with parameters at an end."""
ROUNDS = (0.1, 0.03, 0.01)
"""Steps around the best candidates, in length scales."""
BEST, COPIES = 6, 24


def choices_among(rng: np.random.Generator, worst: Floats) -> Floats:
    """Return candidates (m, p), given the worst starts (k, p)."""
    k, dimension = worst.shape
    return np.vstack(
        [
            rng.random((WIDE, dimension)),
            # From one parameter at an end to a corner: failures of control systems like the ends of ranges.
            _at_ends(rng, rng.random((FACES, dimension)), rng.random((FACES, 1))),
            _around(rng, np.repeat(worst, NEAR, axis=0)),
            _at_ends(rng, np.repeat(worst, SNAPPED, axis=0), np.full((k * SNAPPED, 1), max(0.25, 1 / dimension))),
        ]
    )


def nearby(rng: np.random.Generator, best: Floats, steps: Floats) -> Floats:
    """Return the best candidates (k, p) and copies that differ by about `steps` (p,) in some of the parameters."""
    copies = np.repeat(best, COPIES, axis=0)
    moved = rng.random(copies.shape) < max(0.3, 2 / copies.shape[1])
    return np.vstack([best, np.clip(copies + steps * rng.standard_normal(copies.shape) * moved, 0.0, 1.0)])


def _at_ends(rng: np.random.Generator, points: Floats, probability: Floats) -> Floats:
    """Return the points with each parameter at one of its ends with the probability of its row, shape (n, 1)."""
    chosen, ends = rng.random(points.shape) < probability, (rng.random(points.shape) < 0.5).astype(np.float64)
    return np.where(chosen, ends, points)


def _around(rng: np.random.Generator, points: Floats) -> Floats:
    """Return the points moved by steps from a 200th to a third of a range, half of them in a few parameters only."""
    n, dimension = points.shape
    steps = 10.0 ** rng.uniform(-2.3, -0.5, (n, 1))
    share = np.where(rng.random((n, 1)) < 0.5, 1.0, max(0.2, 1.5 / dimension))
    moved = rng.random(points.shape) < share
    return np.clip(points + steps * rng.standard_normal(points.shape) * moved, 0.0, 1.0)


Point = tuple[float, ...]
Admitted = Callable[[Floats], NDArray[np.bool_]]
"""Whether each of some points (m, p) of the box may be proposed."""
Score = Callable[[Surrogate, Floats, float], Floats]
"""(model, points (m, p), level) -> values of an acquisition function, shape (m,)."""

LARGEST = 200
"""Tests that the model contains; of more, the worst half and an even choice of the others."""
LARGEST_FITTED = 80
"""Tests that the length scales are fitted to, chosen alike."""
WORST = 4
"""Starts with candidates of their own."""
GROWTH = 0.1
"""The length scales are fitted again after so many more tests, relative to their number."""
TIE = 0.05
"""Relative difference of an acquisition function that another machine may see."""
BLOCK = 1024
"""Points of a Sobol sequence; the next ones are of a sequence of its own."""
MODEL, SOBOL = 0, 1
"""Streams of random numbers."""


class Falsifier:
    """A search over a box, fed with tests and their robustness; not thread-safe.

    Points that are not `admitted` are not chosen by the model, unless it finds no other; the middle and the starts of
    the Sobol sequence may be such points.

    A proposal is a function of the seed, of the observations in their order and of the tests in flight: on one machine
    the same ones give the same bits. Its test number is that of the observations and the tests in flight together.

    Raises:
        ValueError: the box is empty, not finite, or has ends of different lengths; `random_every` is below 1.

    >>> search = Falsifier((0.0, -1.0), (10.0, 1.0), seed=1)
    >>> start = search.propose()
    >>> start
    (5.0, 0.0)
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
    ) -> None:
        self._low, self._high = np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
        if self._low.ndim != 1 or self._low.shape != self._high.shape or not len(self._low):
            raise ValueError(f"box {list(low)} to {list(high)}: give one low and one high end per parameter")
        if not np.all(np.isfinite(self._high - self._low) & (self._low < self._high)):
            raise ValueError(f"box {list(low)} to {list(high)}: every low end must be below its high end, both finite")
        if random_every < 1:
            raise ValueError(f"random_every must be at least 1, not {random_every}")
        self._seed, self._random_every, self._admitted = seed, random_every, admitted
        self._points: list[Floats] = []
        self._values: list[float] = []
        self._theta, self._next_fit = prior_mode(len(self._low)), 3
        self._sobol: tuple[int, Floats] = (-1, np.empty(0))

    @property
    def observations(self) -> int:
        """Number of observations."""
        return len(self._values)

    def is_random(self, test: int) -> bool:
        """Whether test `test` is a start of the Sobol sequence, whatever was observed."""
        return (test + 1) % self._random_every == 0

    def propose(self, pending: Sequence[Point] = ()) -> Point:
        """Return the next test (p,), given the tests in flight, which it does not repeat."""
        test = self.observations + len(pending)
        # Without these the search took twice as many tests to find narrow needles, plateaus and jumps.
        if self.is_random(test):
            return self._point(self._sobol_point(test // self._random_every))
        if not self._values:
            # Without any observation: the middle, then fresh Sobol points of the second half of the first block.
            return self._point(np.full(len(self._low), 0.5) if not test else self._sobol_point(BLOCK // 2 + test))
        return self._point(self._by_model(test, [self._unit(each) for each in pending]))

    def is_as_good(self, point: Point, proposal: Point, pending: Sequence[Point] = ()) -> bool:
        """Whether another machine, which rounds differently, could have chosen `point` in place of the proposal.

        Rounding grows in the fit of the length scales and decides between candidates of almost equal value, so that
        the points may be far apart while the acquisition function is about the same.
        """
        test = self.observations + len(pending)
        if self.is_random(test) or not self._values:
            return point == proposal
        model, score, level = self._model(test, [self._unit(each) for each in pending])
        own, other = score(model, np.stack([self._unit(proposal), self._unit(point)]), level).tolist()
        return bool(other >= own - TIE * max(1.0, abs(own)))

    def observe(self, point: Point, value: float) -> None:
        """Add the robustness of a test; on an error nothing changes.

        Raises:
            ValueError: the point has another number of parameters or is outside the box, or `value` is not finite.

        """
        at = np.array(point, dtype=np.float64)
        if at.shape != self._low.shape or not np.all((at >= self._low) & (at <= self._high)):
            raise ValueError(f"point {point} is not in the box {self._low.tolist()} to {self._high.tolist()}")
        if not math.isfinite(value):
            raise ValueError(f"the robustness of {point} is {value}; a search needs finite numbers, clip it")
        self._points.append(self._unit(point))
        self._values.append(value)
        # At numbers of observations alone, so that tests in flight change no length scale.
        if self.observations >= self._next_fit:
            points, z, _ = self._chosen(LARGEST_FITTED)
            self._theta = fitted(points, z, self._theta)
            self._next_fit = self.observations + max(1, int(GROWTH * self.observations))

    def _by_model(self, test: int, pending: list[Floats]) -> Floats:
        model, score, level = self._model(test, pending)
        rng = np.random.default_rng([self._seed, MODEL, test])
        worst = np.argsort(self._values, kind="stable")[:WORST]
        found = self._inside(choices_among(rng, np.array([self._points[each] for each in worst])))
        for step in ROUNDS:
            best = found[np.argsort(-score(model, found, level), kind="stable")[:BEST]]
            found = self._inside(nearby(rng, best, step * np.minimum(model.lengths, 1.0)))
        return np.asarray(found[np.argmax(score(model, found, level))], dtype=np.float64)

    def _inside(self, found: Floats) -> Floats:
        """Return the admitted ones of some points (m, p) of the unit box; all of them if there are none."""
        if self._admitted is None:
            return found
        inside = self._admitted(self._low + found * (self._high - self._low))
        return found[inside] if inside.any() else found

    def _model(self, test: int, pending: list[Floats]) -> tuple[Surrogate, Score, float]:
        """Return the model of a test, its acquisition function and the level of that."""
        points, z, level = self._chosen(LARGEST)
        # Beyond so many tests in flight, only the latest are kept apart: a bound on the cost.
        model = Surrogate(self._theta, points, z, pending[-LARGEST:])
        return (model, _improvement, float(np.min(z))) if test % 3 == 1 else (model, _chance_of_failure, level)

    def _chosen(self, largest: int) -> tuple[Floats, Floats, float]:
        """Return at most `largest` tests (n, p), their warped values (n,) and the level of 0 on that scale."""
        z, level = warped(np.array(self._values))
        points = np.array(self._points)
        if len(z) <= largest:
            return points, z, level
        order = np.argsort(z, kind="stable")
        worst, others = order[: largest // 2], np.sort(order[largest // 2 :])
        spread = np.linspace(0, len(others) - 1, largest - len(worst)).astype(np.intp)
        kept = np.sort(np.concatenate([worst, others[spread]]))
        return points[kept], z[kept], level

    def _sobol_point(self, number: int) -> Floats:
        from scipy.stats import qmc  # noqa: PLC0415  (a second of start-up that few commands need)

        block, row = divmod(number, BLOCK)
        if self._sobol[0] != block:
            rng = np.random.default_rng([self._seed, SOBOL, block])
            self._sobol = block, qmc.Sobol(len(self._low), rng=rng).random(BLOCK)
        return np.asarray(self._sobol[1][row], dtype=np.float64)

    def _point(self, unit: Floats) -> Point:
        # Rounding may leave the box by one unit in the last place.
        return tuple(np.clip(self._low + unit * (self._high - self._low), self._low, self._high).tolist())

    def _unit(self, point: Point) -> Floats:
        return np.asarray((np.array(point) - self._low) / (self._high - self._low), dtype=np.float64)


def _chance_of_failure(model: Surrogate, points: Floats, level: float) -> Floats:
    """Return what the probability of a value below the level grows with, shape (m,)."""
    mean, sd = model.moments(points)
    return (level - mean) / sd


def _improvement(model: Surrogate, points: Floats, level: float) -> Floats:
    """Return the logarithm of the expected improvement below the level, shape (m,).

    Formula: with u = (level - mu)/sigma, ln sigma + ln(u Phi(u) + phi(u)); far below, phi(u)/u^2 (Mills' ratio).
    """
    mean, sd = model.moments(points)
    u = (level - mean) / sd
    density = -0.5 * u * u - 0.5 * math.log(2 * math.pi)  # ln phi(u)
    # ln(1 + u Phi(u)/phi(u)); its argument loses its digits where Phi is small.
    ratio = u * np.exp(np.minimum(scipy.special.log_ndtr(u) - density, 700.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.where(u > -25.0, np.log1p(np.maximum(ratio, -1.0)), -2.0 * np.log(np.abs(u)))
    return np.asarray(np.log(sd) + density + inner, dtype=np.float64)

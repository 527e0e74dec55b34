"""Points of the unit box among which a search chooses: everywhere, at the ends of ranges, and around its worst starts.

The knots of an input over time are neighbours: an input that stays where it is for a while, or moves as a whole, is a
shape that independent knots almost never have, and the one that fails a system whose state needs time.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ..gp.kernels import Floats

WIDE, SHAPED, CROSSED, NEAR, SNAPPED = 256, 192, 128, 64, 24
"""Points in the whole box, shaped ones, mixtures of two starts, and of each worst start: around it, and with parameters
at an end."""
WORST, PARENTS = 4, 12
"""Starts with candidates of their own, and those that are mixed."""
BEST, COPIES = 6, 24


class Inputs:
    """Which parameters follow one another in time: for each parameter, whether it is a knot after another one."""

    def __init__(self, dimension: int, signals: Sequence[Sequence[int]] = ()) -> None:
        self.dimension = dimension
        self.over_time = any(len(knots) > 1 for knots in signals)
        """Whether there is any input with several knots."""
        self._follows = np.zeros(dimension, dtype=np.bool_)
        for knots in signals:
            self._follows[list(knots[1:])] = True

    def held(self, rng: np.random.Generator, values: Floats, probability: Floats) -> Floats:
        """Return the rows (n, p) in which a knot has the value of the one before with the probability of its row."""
        if not self._follows.any():
            return values
        holds = (rng.random(values.shape) < probability) & self._follows
        # Of each knot the latest one that holds no other.
        source = np.maximum.accumulate(np.where(holds, 0, np.arange(self.dimension)), axis=1)
        return np.take_along_axis(values, source, axis=1)


Shape = Callable[[np.random.Generator, int, Inputs], Floats]
"""(random numbers, n, inputs) -> starts (n, p)."""


def shaped(rng: np.random.Generator, n: int, inputs: Inputs) -> Floats:
    """Return starts (n, p) of which some parameters are at an end, from one of them to a corner, and inputs stay."""
    points = _at_ends(rng, rng.random((n, inputs.dimension)), rng.random((n, 1)))
    return inputs.held(rng, points, _often(rng, n))


def cornered(rng: np.random.Generator, n: int, inputs: Inputs) -> Floats:
    """Return starts (n, p) of which every parameter is at an end, and inputs stay there for long."""
    return inputs.held(rng, (rng.random((n, inputs.dimension)) < 0.5).astype(np.float64), rng.uniform(0.5, 1.0, (n, 1)))


def choices_among(rng: np.random.Generator, worst: Floats, inputs: Inputs) -> Floats:
    """Return candidates (m, p), given the starts (k, p), the worst one first."""
    dimension, around = inputs.dimension, worst[:WORST]
    return np.vstack(
        [
            rng.random((WIDE, dimension)),
            # Failures of control systems like the ends of ranges.
            shaped(rng, SHAPED, inputs),
            _around(rng, np.repeat(around, NEAR, axis=0), inputs),
            _snapped(rng, np.repeat(around, SNAPPED, axis=0), inputs),
            _crossed(rng, worst, inputs),
        ]
    )


def nearby(rng: np.random.Generator, best: Floats, steps: Floats) -> Floats:
    """Return the best candidates (k, p) and copies that differ by about `steps` (p,) in some of the parameters."""
    copies = np.repeat(best, COPIES, axis=0)
    moved = rng.random(copies.shape) < max(0.3, 2 / copies.shape[1])
    return np.vstack([best, np.clip(copies + steps * rng.standard_normal(copies.shape) * moved, 0.0, 1.0)])


def _often(rng: np.random.Generator, n: int) -> Floats:
    """Return how often the knots of each row hold, (n, 1): of half of them never."""
    return np.where(rng.random((n, 1)) < 0.5, 0.0, rng.random((n, 1)))


def _at_ends(rng: np.random.Generator, points: Floats, probability: Floats) -> Floats:
    """Return the points with each parameter at one of its ends with the probability of its row, shape (n, 1)."""
    chosen, ends = rng.random(points.shape) < probability, (rng.random(points.shape) < 0.5).astype(np.float64)
    return np.where(chosen, ends, points)


def _snapped(rng: np.random.Generator, points: Floats, inputs: Inputs) -> Floats:
    """Return the points with some of the parameters, or a while of an input, at an end."""
    n, dimension = points.shape
    often = _often(rng, n)
    share = max(0.25, 1 / dimension)
    chosen = inputs.held(rng, (rng.random(points.shape) < share).astype(np.float64), often) > 0
    return np.where(chosen, inputs.held(rng, (rng.random(points.shape) < 0.5).astype(np.float64), often), points)


def _crossed(rng: np.random.Generator, parents: Floats, inputs: Inputs) -> Floats:
    """Return points that have each parameter, or a while of an input, from one of two starts."""
    one, other = (parents[rng.integers(len(parents), size=CROSSED)] for _ in range(2))
    chosen = inputs.held(rng, (rng.random(one.shape) < 0.5).astype(np.float64), rng.random((CROSSED, 1))) > 0
    return np.where(chosen, one, other)


def _around(rng: np.random.Generator, points: Floats, inputs: Inputs) -> Floats:
    """Return the points moved by steps from a 200th to a third of a range, half of them in a few parameters only."""
    n, dimension = points.shape
    steps = 10.0 ** rng.uniform(-2.3, -0.5, (n, 1))
    share = np.where(rng.random((n, 1)) < 0.5, 1.0, max(0.2, 1.5 / dimension))
    moved = rng.standard_normal(points.shape) * (rng.random(points.shape) < share)
    moved = inputs.held(rng, moved, _often(rng, n))
    return np.asarray(np.clip(points + steps * moved, 0.0, 1.0), dtype=np.float64)

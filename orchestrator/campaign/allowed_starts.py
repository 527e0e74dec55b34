"""The starts that a campaign may simulate, and the one that is nearest to a point."""

import math
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

import numpy as np

from ...schemas.file.parameters import parameter_ranges
from ...schemas.file.space import Range
from ...schemas.result.facts import Header
from ..mathematics.distributions import to_digits
from ..mathematics.gp.kernels import Floats
from .draws import DIGITS
from .region import Start


class AllowedStarts(Protocol):
    """The starts that a campaign may simulate."""

    @property
    def box(self) -> tuple[Floats, Floats]:
        """The smallest and the largest values, shape (p,) each."""
        ...

    def nearest(self, point: Floats, taken: Collection[int]) -> tuple[int | None, Start]:
        """Return the allowed start nearest to a point (p,), with its number in a list, which is none of `taken`."""
        ...


class Listed:
    """Finitely many starts, shape (m, p): nodes of a lattice, scenarios, or the rows of a table."""

    def __init__(self, starts: Floats, *, numbered: bool = True) -> None:
        self._starts, self._numbered = starts, numbered
        self.box = starts.min(axis=0), starts.max(axis=0)
        span = self.box[1] - self.box[0]
        self._scale = np.where(span > 0, span, 1.0)

    def nearest(self, point: Floats, taken: Collection[int]) -> tuple[int | None, Start]:
        """Return the nearest start, distances in shares of the ranges; ties to the lowest number."""
        distances = np.sum(((self._starts - point) / self._scale) ** 2, axis=1)
        distances[list(taken)] = math.inf
        chosen = int(np.argmin(distances))
        return chosen if self._numbered else None, tuple(self._starts[chosen].tolist())


class Ranges:
    """A range for each parameter, with its steps or choices."""

    def __init__(self, ranges: Sequence[Range]) -> None:
        self.box = np.array([each.low for each in ranges]), np.array([each.high for each in ranges])
        self._nearest = [_nearest(each) for each in ranges]

    def nearest(self, point: Floats, taken: Collection[int]) -> tuple[int | None, Start]:  # noqa: ARG002
        """Return the nearest value of every parameter; there is no list."""
        return None, tuple(near(value) for near, value in zip(self._nearest, point.tolist(), strict=True))


def of_space(header: Header) -> AllowedStarts:
    """Return the starts that `[space]` lists, or of its ranges; `where` is a condition of its own."""
    space = header.config.space
    if not isinstance(space, dict):
        return Listed(np.array(space.rows), numbered=False)
    ranges = parameter_ranges(space)
    return Ranges([ranges[each.name] for each in header.spec.parameters])


def _nearest(given: Range) -> Callable[[float], float]:
    """Return the allowed value of a parameter that is nearest to a number; rounded as drawn ones are."""
    low, high, step, choices = given.low, given.high, given.step, given.choices
    if choices is not None:
        return lambda value: min(choices, key=lambda each: (abs(each - value), each))
    if step is not None:
        # 15 digits: 0.1 + 2 * 0.1 is 0.3, as written.
        return lambda value: min(max(float(f"{low + round((value - low) / step) * step:.15g}"), low), high)
    return lambda value: to_digits(np.array([value]), low, high, DIGITS)[0]

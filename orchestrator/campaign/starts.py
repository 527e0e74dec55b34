"""Starts: drawn from the distribution of `[space]`, and the nearest allowed one."""

import itertools
import math
from collections.abc import Callable, Collection, Sequence
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from ...schemas.draws.distributions import to_digits, truncated
from ...schemas.draws.laws import coordinate
from ...schemas.errors import CampaignError
from ...schemas.file.disturbance import Disturbance
from ...schemas.file.parameters import Box, Range, parameter_ranges
from ...schemas.file.space import StartTable
from ...schemas.result.facts import Header
from ...schemas.system import Parameter, SystemSpec
from ..mathematics.sobol import BLOCK as BLOCK_OF_SOBOL
from ..mathematics.sobol import sobol_blocks
from .region import Start, condition
from .seeds import Floats, uniform

DIGITS = 9
"""Significant digits of a drawn number, see `Draws`."""
BLOCK = 256
"""Starts that are computed together; scipy takes 100 us a call, however many numbers it gets."""

MOST_ATTEMPTS = 100_000
"""At the least share of a region that is allowed, one start in e^100 needs more."""
LEAST_SHARE = 1e-3
"""Of the distribution in the region; below it most time goes into attempts."""
SHARE_BLOCKS = 25
"""Blocks of the Sobol sequence that show the share of a region: 10^5 starts."""

Value = TypeVar("Value")
Column = Callable[[Floats], list[float]]
"""The values of a parameter for shares (n,)."""


class Draws:
    """The starts 0, 1, 2, ... of one design of a campaign, parameters in the order of the system.

    Start j follows from the seed and the digest of the campaign, the name of the design and j: neither the order in
    which starts are asked for nor workers and restarts change it. Of ranges each parameter takes one uniform number
    through the inverse of its distribution; of a table a start takes one, for its row.

    With `where` each attempt at start j takes row j of a table of its own, until one is in the region: the starts are
    those of the distribution under the condition that `where` holds.

    Drawn numbers are rounded to `DIGITS` significant digits, of the value or of the width of its range, and stay in
    [low, high]: the logarithms and roots of scipy may differ in their last bits between machines, and starts should
    not. A difference survives where a limit of rounding is between the two: at most one number in a million. A table's
    rows, choices and steps are taken as they are. Not thread-safe. The first start finds what is wrong:

    Raises:
        ValueError: the campaign was not checked: a distribution has almost nothing in its range, or `where` is no
            condition.
        CampaignError: almost nothing of the distribution is in the region.
        TypeError: its space is a list of scenarios.

    """

    def __init__(self, header: Header, design: str) -> None:
        self._header, self._series = header, f"{design}.starts"
        self._condition = condition(header.config.where, [each.name for each in header.spec.parameters])
        self._block: tuple[int, list[Start]] = (-1, [])

    @cached_property
    def _transform(self) -> tuple[int, Callable[[Floats], list[Start]]]:
        # Once it is needed: scipy's distributions take a second to load, and a report draws no start.
        return _transform(self._header)

    def start(self, number: int) -> Start:
        """Return start `number`; raises IndexError if it is negative."""
        if number < 0:
            raise IndexError(f"start {number} of a design; the first one is 0")
        block, row = divmod(number, BLOCK)
        # Whole blocks alone, from multiples of their size: each number is computed among the same others, in any order.
        if self._block[0] != block:
            rows = range(block * BLOCK, (block + 1) * BLOCK)
            self._block = block, self._drawn(rows)
        return self._block[1][row]

    def _drawn(self, rows: range) -> list[Start]:
        """Return starts of the region: start j is the first of its own attempts that is there."""
        width, starts_of = self._transform
        starts = starts_of(uniform(self._header, self._series, rows, width))
        if self._condition is None:
            return starts
        outside = np.flatnonzero(~self._condition(starts))
        for attempt in range(1, MOST_ATTEMPTS):
            if not outside.size:
                return starts
            shares = uniform(self._header, self._series, rows, width, attempt=attempt)
            again = starts_of(shares[outside])
            for k, start in zip(outside.tolist(), again, strict=True):
                starts[k] = start
            outside = outside[~self._condition(again)]
        raise CampaignError(
            f"space.where: a start of the region was not found in {MOST_ATTEMPTS} attempts; choose narrower ranges"
        )


def drawn_starts(header: Header, design: str) -> Callable[[int], Start]:
    """Return start 0, 1, 2, ... of the tests of a problem: drawn here, or those from which logs were made."""
    tests, names = header.config.recorded, [each.name for each in header.spec.parameters]
    if not tests:
        return Draws(header, design).start
    return lambda number: tuple(tests[number].start[name] for name in names)


def _transform(header: Header) -> tuple[int, Callable[[Floats], list[Start]]]:
    """Return how many uniform numbers a start takes, and how starts follow from them, shape (n, width)."""
    space = header.config.space
    if isinstance(space, StartTable):
        row = _chosen(space.rows)
        return 1, lambda shares: row(shares[:, 0])
    if isinstance(space, dict):
        ranges, spec = parameter_ranges(space), header.spec
        columns = [_of_range(each.name, ranges[each.name]) for each in spec.own_parameters]
        # With a search over disturbances these are part of each start: a drawn one has drawn ones.
        columns += drawn_disturbances(spec)
        return len(columns), _of_columns(columns)
    raise TypeError("no method that draws its starts takes a list of scenarios")


def drawn_disturbances(spec: SystemSpec) -> list[Column]:
    """Return what draws each disturbance that is a parameter, in the order of a start: its scores, or its choices."""
    return [_of_law(law) for law in spec.disturbances if law.name in spec.as_parameters]


def check_distributions(space: Box, source: str) -> None:
    """Refuse a distribution that has almost nothing in its range.

    Raises:
        CampaignError: one line with the source, the parameter and the remedy.

    """
    ranges = parameter_ranges(space)
    try:
        _of_box(ranges, list(ranges))
    except ValueError as error:
        raise CampaignError(f"{source}: {error}") from None


def check_where(space: Box, where: str, source: str) -> None:
    """Refuse a condition that is none, or that leaves almost nothing of the distribution of a space.

    Raises:
        CampaignError: one line with the source and the remedy.

    """
    ranges = parameter_ranges(space)
    try:
        admitted, starts = condition(where, list(ranges)), _of_box(ranges, list(ranges))
    except ValueError as error:
        raise CampaignError(f"{source}: {error}") from None
    assert admitted is not None, "there is a condition"
    inside, points = 0, SHARE_BLOCKS * BLOCK_OF_SOBOL
    for shares in itertools.islice(sobol_blocks(len(ranges)), SHARE_BLOCKS):
        inside += int(admitted(starts(shares)).sum())
        if inside >= LEAST_SHARE * points:
            return  # whatever the other points are; most regions need one block
    raise CampaignError(
        f"{source}: space.where: holds at {inside:,} of {points:,} starts of the ranges, less than 1 in "
        f"{1 / LEAST_SHARE:,.0f}; fix the condition, or choose narrower ranges"
    )


def _chosen(values: Sequence[Value]) -> Callable[[Floats], list[Value]]:
    """Return the choice of one of the values with equal probabilities, for shares (n,)."""
    # A share below 1 may become the number of values: 1 - 2^-53 times 3 rounds to 3.
    return lambda shares: [values[min(int(share * len(values)), len(values) - 1)] for share in shares.tolist()]


def _of_law(law: Disturbance) -> Callable[[Floats], list[float]]:
    found = coordinate(law)
    return lambda shares: found(shares).tolist()


def _of_box(space: Box, names: list[str]) -> Callable[[Floats], list[Start]]:
    return _of_columns([_of_range(name, space[name]) for name in names])


def _of_columns(columns: Sequence[Column]) -> Callable[[Floats], list[Start]]:
    def starts(shares: Floats) -> list[Start]:
        each = [column(np.ascontiguousarray(shares[:, k])) for k, column in enumerate(columns)]
        return list(zip(*each, strict=True))

    return starts


def _of_range(name: str, given: Range) -> Callable[[Floats], list[float]]:
    """Return the values of a parameter for shares (n,)."""
    if given.choices is not None:
        return _chosen(given.choices)
    low, high, step = given.low, given.high, given.step
    try:
        inverse = truncated(given.distribution, given.described, low, high, beyond=(step or 0.0) / 2)
    except ValueError:
        keys = " and ".join(f"{key} {value:g}" for key, value in given.described.items())
        raise ValueError(
            f"space.{name}.distribution: almost nothing of {given.distribution!r} with {keys} is in "
            f"[{low:g}, {high:g}]; fix the unit or the range"
        ) from None
    if step is None:
        return lambda shares: to_digits(inverse(shares), low, high, DIGITS)

    def stepped(shares: Floats) -> list[float]:
        numbers = np.clip(np.rint((inverse(shares) - low) / step), 0, given.steps)
        # 15 digits: 0.1 + 2 * 0.1 is 0.3, as written.
        return [min(max(float(f"{each:.15g}"), low), high) for each in (low + numbers * step).tolist()]

    return stepped


# The starts that a campaign may simulate, and the one that is nearest to a point


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
    ranges, spec = parameter_ranges(space), header.spec
    laws = {law.name: law for law in spec.disturbances}
    return Ranges([ranges.get(each.name) or _range_of(each, laws[each.name]) for each in spec.parameters])


def _range_of(parameter: Parameter, law: Disturbance) -> Range:
    """Return the values of a disturbance that a search may choose."""
    # Not validated: a law may have one choice alone.
    choices = None if law.choices is None else tuple(sorted(set(law.choices)))
    return Range.model_construct(low=parameter.low, high=parameter.high, choices=choices)


def _nearest(given: Range) -> Callable[[float], float]:
    """Return the allowed value of a parameter that is nearest to a number; rounded as drawn ones are."""
    low, high, step, choices = given.low, given.high, given.step, given.choices
    if choices is not None:
        return lambda value: min(choices, key=lambda each: (abs(each - value), each))
    if step is not None:
        # 15 digits: 0.1 + 2 * 0.1 is 0.3, as written.
        return lambda value: min(max(float(f"{low + round((value - low) / step) * step:.15g}"), low), high)
    return lambda value: to_digits(np.array([value]), low, high, DIGITS)[0]

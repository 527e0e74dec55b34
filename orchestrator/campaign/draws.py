"""Starts that are drawn from the distribution of `[space]`: a function of the campaign and their number alone."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from ...schemas.errors import CampaignError
from ...schemas.facts import Header
from ...schemas.parameters import parameter_ranges
from ...schemas.space import Box, Range, StartTable
from ..mathematics.distributions import to_digits, truncated
from .seeds import Floats, uniform

DIGITS = 9
"""Significant digits of a drawn number, see `Draws`."""
BLOCK = 256
"""Starts that are computed together; scipy takes 100 us a call, however many numbers it gets."""

Start = tuple[float, ...]
Value = TypeVar("Value")


class Draws:
    """The starts 0, 1, 2, ... of one design of a campaign, parameters in the order of the system.

    Start j follows from the seed and the digest of the campaign, the name of the design and j: neither the order in
    which starts are asked for nor workers and restarts change it. Of ranges each parameter takes one uniform number
    through the inverse of its distribution; of a table a start takes one, for its row.

    Drawn numbers are rounded to `DIGITS` significant digits, of the value or of the width of its range, and stay in
    [low, high]: the logarithms and roots of scipy may differ in their last bits between machines, and starts should
    not. A difference survives where a limit of rounding is between the two: at most one number in a million. A table's
    rows, choices and steps are taken as they are. Not thread-safe.

    Raises:
        ValueError: the campaign was not checked: a distribution has almost nothing in its range.
        TypeError: its space is a list of scenarios.

    """

    def __init__(self, header: Header, design: str) -> None:
        self._header, self._series = header, f"{design}.starts"
        self._width, self._starts = _transform(header)
        self._block: tuple[int, list[Start]] = (-1, [])

    def start(self, number: int) -> Start:
        """Return start `number`; raises IndexError if it is negative."""
        if number < 0:
            raise IndexError(f"start {number} of a design; the first one is 0")
        block, row = divmod(number, BLOCK)
        # Whole blocks alone, from multiples of their size: each number is computed among the same others, in any order.
        if self._block[0] != block:
            rows = range(block * BLOCK, (block + 1) * BLOCK)
            self._block = block, self._starts(uniform(self._header, self._series, rows, self._width))
        return self._block[1][row]


def _transform(header: Header) -> tuple[int, Callable[[Floats], list[Start]]]:
    """Return how many uniform numbers a start takes, and how starts follow from them, shape (n, width)."""
    space = header.config.space
    if isinstance(space, StartTable):
        row = _chosen(space.rows)
        return 1, lambda shares: row(shares[:, 0])
    if isinstance(space, dict):
        ranges = parameter_ranges(space)
        return len(ranges), _of_box(ranges, [parameter.name for parameter in header.spec.parameters])
    raise TypeError("no method that draws its starts takes a list of scenarios")


def check_distributions(space: Box, source: str) -> None:
    """Refuse a distribution that has almost nothing in its range.

    Raises:
        CampaignError: one line with the source, the parameter and the remedy.

    """
    try:
        _of_box(space, list(space))
    except ValueError as error:
        raise CampaignError(f"{source}: {error}") from None


def _chosen(values: Sequence[Value]) -> Callable[[Floats], list[Value]]:
    """Return the choice of one of the values with equal probabilities, for shares (n,)."""
    # A share below 1 may become the number of values: 1 - 2^-53 times 3 rounds to 3.
    return lambda shares: [values[min(int(share * len(values)), len(values) - 1)] for share in shares.tolist()]


def _of_box(space: Box, names: list[str]) -> Callable[[Floats], list[Start]]:
    columns = [_of_range(name, space[name]) for name in names]

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

"""Starts that are drawn from the distribution of `[space]`: a function of the campaign and their number alone."""

from collections.abc import Callable

import numpy as np

from ...schemas.errors import CampaignError
from ...schemas.facts import Header
from ...schemas.space import Box, StartTable
from ..mathematics.distributions import to_digits, truncated
from .seeds import Floats, uniform

DIGITS = 9
"""Significant digits of a drawn number, see `Draws`."""
BLOCK = 256
"""Starts that are computed together; scipy takes 100 us a call, however many numbers it gets."""

Start = tuple[float, ...]


class Draws:
    """The starts 0, 1, 2, ... of one design of a campaign, parameters in the order of the system.

    Start j follows from the seed and the digest of the campaign, the name of the design and j: neither the order in
    which starts are asked for nor workers and restarts change it. Of ranges each parameter takes one uniform number
    through the inverse of its distribution; of a table a start takes one, for its row.

    Drawn numbers are to_digits to `DIGITS` significant digits, of the value or of the width of its range, and stay in
    [low, high]: the logarithms and roots of scipy may differ in their last bits between machines, and starts should
    not. A difference survives where a limit of rounding is between the two: at most one number in a million. A table's
    rows are taken as they are. Not thread-safe.

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
        # Whole blocks alone, from multiples of their size: each number is computed among the same others, whoever asks.
        if self._block[0] != block:
            rows = range(block * BLOCK, (block + 1) * BLOCK)
            self._block = block, self._starts(uniform(self._header, self._series, rows, self._width))
        return self._block[1][row]


def _transform(header: Header) -> tuple[int, Callable[[Floats], list[Start]]]:
    """Return how many uniform numbers a start takes, and how starts follow from them, shape (n, width)."""
    space = header.config.space
    if isinstance(space, StartTable):
        return 1, _of_table(space)
    if isinstance(space, dict):
        return len(space), _of_box(space, [parameter.name for parameter in header.spec.parameters])
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


def _of_table(space: StartTable) -> Callable[[Floats], list[Start]]:
    rows = space.table

    def starts(shares: Floats) -> list[Start]:
        # A share below 1 may become the number of rows: 1 - 2^-53 times 3 rounds to 3.
        return [rows[min(int(share * len(rows)), len(rows) - 1)] for share in shares[:, 0].tolist()]

    return starts


def _of_box(space: Box, names: list[str]) -> Callable[[Floats], list[Start]]:
    inverses = []
    for name in names:
        each = space[name]
        try:
            inverses.append(truncated(each.distribution, each.described, each.low, each.high))
        except ValueError:
            given = " and ".join(f"{key} {value:g}" for key, value in each.described.items())
            raise ValueError(
                f"space.{name}.distribution: almost nothing of {each.distribution!r} with {given} is in "
                f"[{each.low:g}, {each.high:g}]; fix the unit or the range"
            ) from None

    def starts(shares: Floats) -> list[Start]:
        columns = [
            to_digits(inverse(np.ascontiguousarray(shares[:, k])), space[name].low, space[name].high, DIGITS)
            for k, (name, inverse) in enumerate(zip(names, inverses, strict=True))
        ]
        return list(zip(*columns, strict=True))

    return starts

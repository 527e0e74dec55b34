"""Lines of a certificate on a console: plain text with styles, never markup."""

import re
import textwrap
from collections.abc import Collection, Sequence

from rich.console import Console
from rich.text import Text

WIDTH = 100
FIXED = "\N{NO-BREAK SPACE}"
"""At which no line ends."""
BOUND = re.compile(r"[<>]= \S+(?: \S{1,4}(?=[, ]|$))?")


def hanging(console: Console, head: Text, body: str) -> None:
    """Print `body` right of `head`, wrapped, its lines below each other."""
    indent = len(head.plain)
    width = min(console.width, WIDTH) if console.is_terminal else WIDTH
    # A bound stays beside its sign and its unit.
    joined = BOUND.sub(lambda found: found[0].replace(" ", FIXED), body)
    lines = textwrap.wrap(joined, max(40, width - indent), break_long_words=False, break_on_hyphens=False)
    text = ("\n" + " " * indent).join(lines).replace(FIXED, " ")
    console.print(head.append(text), soft_wrap=True)


def heading(console: Console, text: str, style: str) -> None:
    """Print an empty line and a heading."""
    console.print()
    plain_line(console, text, style)


def plain_line(console: Console, text: str, style: str = "") -> None:
    """Print a line, however long."""
    console.print(Text(text, style), soft_wrap=True)


def aligned(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Return rows as lines, with the cells of a column below each other; those of the columns `right` end there.

    >>> aligned([("run", "tests"), ("cars", "7")], right={1})
    ['run   tests', 'cars      7']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if place in right else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]

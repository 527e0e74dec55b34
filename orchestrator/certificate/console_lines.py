"""Lines of a certificate on a console: plain text with styles, never markup."""

import textwrap

from rich.console import Console
from rich.text import Text

WIDTH = 100


def hanging(console: Console, head: Text, body: str) -> None:
    """Print `body` right of `head`, wrapped, its lines below each other."""
    indent = len(head.plain)
    width = min(console.width, WIDTH) if console.is_terminal else WIDTH
    lines = textwrap.wrap(body, max(40, width - indent), break_long_words=False, break_on_hyphens=False)
    console.print(head.append(("\n" + " " * indent).join(lines)), soft_wrap=True)


def heading(console: Console, text: str, style: str) -> None:
    """Print an empty line and a heading."""
    console.print()
    plain_line(console, text, style)


def plain_line(console: Console, text: str, style: str = "") -> None:
    """Print a line, however long."""
    console.print(Text(text, style), soft_wrap=True)

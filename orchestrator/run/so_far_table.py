"""What a run has shown so far, on a console: a table of two rows, a progress bar, and the tested assumptions."""

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from ...schemas.result.so_far import SoFar
from .so_far_text import HEAD, assumption_words, bar_words, holding_rows, violations_so_far
from .verdict import COLOURS

BAR = 40
"""Columns of the progress bar."""


def so_far_view(found: SoFar, *, running: bool = True) -> Group:
    """Return everything that holds now, as lines for a console."""
    return Group(*_lines_of(found, running=running))


def _lines_of(found: SoFar, *, running: bool) -> Iterator[RenderableType]:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in HEAD:
        table.add_column(name, overflow="fold")
    colours = (COLOURS[found.verdict], COLOURS[found.expected.verdict] if found.expected.verdict else "")
    for row, colour in zip(holding_rows(found, running=running), colours, strict=True):
        table.add_row(*(Text(cell) for cell in row[:-1]), Text(row.verdict, colour))
    yield table
    bar = Table.grid(padding=(0, 1))
    bar.add_row(ProgressBar(total=1.0, completed=found.expected.share, width=BAR), Text(bar_words(found.expected)))
    yield bar
    if words := violations_so_far(found):
        yield Text(words, "red" if found.violations.violations else "")
    if words := assumption_words(found):
        yield Text(words, "bold red" if "REFUTED" in words else "")

"""Tables as text: CSV and Markdown."""

import csv
import io
from collections.abc import Iterable, Sequence


def csv_text(head: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV; None is an empty cell.

    >>> csv_text(["a", "b"], [[0.5, None]])
    'a,b\\n0.5,\\n'
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(lines)
    return text.getvalue()


def markdown(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown whose columns are aligned in a terminal, too.

    >>> markdown(["a", "b"], [["1", "long"]])
    '| a   | b    |\\n| --- | ---- |\\n| 1   | long |\\n'
    """
    table = [list(head), *map(list, lines)]
    widths = [max(3, *map(len, column)) for column in zip(*table, strict=True)]
    table.insert(1, ["-" * width for width in widths])
    shown = ("| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in table)
    return "\n".join(shown) + "\n"

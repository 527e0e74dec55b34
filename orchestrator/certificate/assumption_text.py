"""Assumptions of a certificate on a console."""

from collections.abc import Iterable

from rich.console import Console
from rich.text import Text

from ...schemas.result.certificate import Assumption
from .assumption_titles import title
from .console_lines import hanging, plain_line

COLOURS = {"refuted": "red", "derived": "green"}
STATUS = 12
"""Columns of a status and the blank behind it; the longest is `not refuted`."""


def print_list(assumptions: Iterable[Assumption], console: Console) -> None:
    """Print assumptions problem by problem: status, what is assumed, its id, and below it the finding."""
    groups: dict[str, list[tuple[str, Assumption]]] = {}
    for each in assumptions:
        name, _, problem = each.id.partition("/")
        groups.setdefault(problem or "whole campaign", []).append((name, each))
    for group, members in groups.items():
        plain_line(console, f"  {group}", "bold")
        for name, each in members:
            head = Text(f"    {each.status:<{STATUS}}", COLOURS.get(each.status, "yellow"))
            console.print(head.append(title(each.id), "bold").append(f" ({name})", "dim"), soft_wrap=True)
            hanging(console, Text(" " * (4 + STATUS)), each.detail)

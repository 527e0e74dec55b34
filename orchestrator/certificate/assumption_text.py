"""Assumptions of a certificate on a console."""

from collections.abc import Iterable

from rich.console import Console
from rich.text import Text

from ...schemas.certificate import Assumption
from .console_lines import hanging, plain_line

COLOURS = {"refuted": "red", "derived": "green"}
NAME = 25
"""Columns of the name of an assumption; the longest are `simulator_is_the_system` and `sampled_at_sample_times`."""


def print_list(assumptions: Iterable[Assumption], console: Console) -> None:
    """Print assumptions problem by problem, with hanging indents."""
    groups: dict[str, list[tuple[str, Assumption]]] = {}
    for each in assumptions:
        name, _, problem = each.id.partition("/")
        groups.setdefault(problem or "whole campaign", []).append((name, each))
    for group, members in groups.items():
        plain_line(console, f"  {group}", "bold")
        for name, each in members:
            # The blank stands apart, so that a name that fills its column keeps it.
            head = Text(f"    {name:<{NAME - 1}} ")
            head.append(f"{each.status:<11} ", COLOURS.get(each.status, "yellow"))
            hanging(console, head, each.detail)

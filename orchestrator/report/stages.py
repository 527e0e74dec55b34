"""Progress of a report, for a terminal."""

from collections.abc import Callable

Report = Callable[[str, int, int], None]
"""Progress callback: stage, completed, total."""


def unreported(_stage: str, _completed: int, _total: int) -> None:
    """Show no progress."""

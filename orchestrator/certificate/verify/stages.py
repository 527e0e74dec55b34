"""The progress of work in stages, as bars; without what the work imports."""

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

Report = Callable[[str, int, int], None]
"""Progress callback: stage, completed, total."""


def stage_bars(progress: "Progress") -> Report:
    """Return a progress callback that draws a bar for every stage."""
    bars = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            bars[stage] = progress.add_task(stage, total=total)
        progress.update(bars[stage], completed=done)

    return report

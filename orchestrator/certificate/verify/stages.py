"""The progress of work in stages, as bars; without what the work imports."""

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

Report = Callable[[str, int, int], None]
"""Progress callback: stage, completed, total."""


def stage_bars(progress: "Progress") -> Report:
    """Return a progress callback that draws a bar for every stage."""
    bars: dict[str, TaskID] = {}

    def report(stage: str, done: int, total: int) -> None:
        # One step has no share before its end: its bar moves, and does not show 0 %.
        known = None if total == 1 and not done else total
        if stage not in bars:
            bars[stage] = progress.add_task(stage, total=known)
        progress.update(bars[stage], completed=done, total=known)

    return report

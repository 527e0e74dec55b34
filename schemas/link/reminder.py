"""The lines about a state that lasts, and the times at which they are printed again."""

import time
from collections.abc import Callable

MOST = 300.0
"""Seconds between two lines of one reminder at most: those of a thousand workers are then three lines a second."""


class Reminder:
    """When a line about a state that lasts is due: `first` s after its begin at `now`, then ever more rarely.

    The pause between two lines doubles up to `most` s. Times are in s of any one clock. Not thread-safe.

    >>> reminder = Reminder(5.0, now=0.0)
    >>> [now for now in range(1000) if reminder.is_due(now)]
    [5, 15, 35, 75, 155, 315, 615, 915]
    """

    def __init__(self, first: float, *, now: float, most: float = MOST) -> None:
        self._pause, self._most = first, most
        self._due = now + first
        self.printed = False
        """Whether a line was due, so that the end of the state is news."""

    def is_due(self, now: float) -> bool:
        """Whether a line is to be printed now; that counts as printed."""
        if now < self._due:
            return False
        self._pause = min(2 * self._pause, self._most)
        self._due, self.printed = now + self._pause, True
        return True


class StateLines:
    """The lines about a state: `line()` while it lasts, ever more rarely, and `over` once it has ended.

    The first line comes `first` s after the state was seen first. Not thread-safe.
    """

    def __init__(self, line: Callable[[], str], over: str, print_line: Callable[[str], None], *, first: float) -> None:
        self._line, self._over, self._print_line, self._first = line, over, print_line, first
        self._reminder: Reminder | None = None

    def see(self, *, lasts: bool) -> None:
        """Take whether the state is there, and print what is due; `line` may take seconds."""
        if lasts:
            self._reminder = self._reminder or Reminder(self._first, now=time.monotonic())
            if self._reminder.is_due(time.monotonic()):
                self._print_line(self._line())
            return
        if self._reminder is not None and self._reminder.printed:
            self._print_line(self._over)
        self._reminder = None

"""The times at which a line is printed again while what it is about lasts."""

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

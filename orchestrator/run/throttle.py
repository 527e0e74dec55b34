"""The limit of lines about messages of peers, so that none of them fills the terminal or a log."""

from collections import Counter
from dataclasses import dataclass, field

EACH = 10
"""Lines of one kind about one worker in a period."""
ALL = 100
"""Lines of one kind about all workers in a period: a peer that chooses names has as many as it likes."""
PERIOD = 60.0
"""Seconds."""


@dataclass(slots=True)
class _Period:
    began: float
    shown: Counter[str] = field(default_factory=Counter)
    hidden: int = 0


class Throttle:
    """The lines of the present period, by kind; a kind is its name in the plural, such as `ignored messages`.

    Time is in seconds of any one clock. Memory is bounded: `ALL` names a kind.
    """

    def __init__(self) -> None:
        self._periods: dict[str, _Period] = {}

    def admits(self, now: float, kind: str, worker: str) -> bool:
        """Count a line; return whether it may be shown."""
        period = self._periods.setdefault(kind, _Period(now))
        if period.shown.get(worker, 0) < EACH and period.shown.total() < ALL:
            period.shown[worker] += 1
            return True
        period.hidden += 1
        return False

    def summaries(self, now: float) -> list[str]:
        """End the periods that are over; return a line for each that left lines out."""
        over = [(kind, period) for kind, period in self._periods.items() if now - period.began >= PERIOD]
        for kind, _ in over:
            del self._periods[kind]
        return [f"{period.hidden} more {kind} in {PERIOD:g} s, not shown" for kind, period in over if period.hidden]

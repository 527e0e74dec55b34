"""What a report shows of the trust in workers: results that were compared, and who was set aside."""

from collections import deque
from dataclasses import dataclass, field

from ...store.changes import Changes, ComparedResult, PauseChange
from ..data.workers import SetAsideRow

MOST = 50
"""Rows of each kind; the export lists all of them."""
REMEMBERED = 1000
"""Workers and hosts whose pauses are counted, the latest."""
LONGEST_REASON = 500
"""Characters of a reason."""


@dataclass(slots=True)
class _Pauses:
    last: PauseChange
    times: int = 0
    for_good: bool = False


@dataclass(slots=True)
class TrustStatistics:
    """The latest results that were compared, those that differ apart, and the pauses by worker and host."""

    compared: int = 0
    _equal: deque[ComparedResult] = field(default_factory=lambda: deque(maxlen=MOST))
    _apart: deque[ComparedResult] = field(default_factory=lambda: deque(maxlen=MOST))
    """Outvoted and reviewed: many comparisons must not push them out."""
    _pauses: dict[tuple[str, str], _Pauses] = field(default_factory=dict)

    def add(self, changes: Changes) -> None:
        """Add new comparisons and pauses."""
        self.compared += len(changes.opinions)
        for opinion in changes.opinions:
            (self._equal if opinion.kind == "compared" else self._apart).append(opinion)
        for pause in changes.pauses:
            if pause.seconds > 0:  # else the early end of one
                self._begin(pause)

    def _begin(self, pause: PauseChange) -> None:
        key = (pause.kind, pause.name)
        known = self._pauses.pop(key, None) or _Pauses(pause)
        # The last one is behind all others, and one for good is never forgotten before them.
        self._pauses[key] = _Pauses(pause, known.times + 1, known.for_good or pause.seconds == float("inf"))
        if len(self._pauses) > REMEMBERED:
            del self._pauses[min(self._pauses, key=lambda each: self._pauses[each].for_good)]

    @property
    def workers(self) -> set[str]:
        """Names of the workers that were set aside or outvoted."""
        paused = {name for kind, name in self._pauses if kind == "worker"}
        return paused | {each.worker for each in self._apart if each.kind == "outvoted"}

    def compared_rows(self) -> tuple[ComparedResult, ...]:
        """Return the latest results that were outvoted or reviewed, then the latest that were compared."""
        left = MOST - len(self._apart)
        return (*reversed(self._apart), *list(reversed(self._equal))[:left])

    def pause_rows(self) -> tuple[SetAsideRow, ...]:
        """Return the workers and hosts that were set aside: for good first, then the latest."""
        chosen = sorted(self._pauses.values(), key=lambda each: (not each.for_good, -each.last.at))[:MOST]
        return tuple(_pause_row(each) for each in chosen)


def _pause_row(found: _Pauses) -> SetAsideRow:
    last = found.last
    return SetAsideRow(last.kind, last.name, found.times, found.for_good, last.at, last.reason[:LONGEST_REASON])

"""Who did the work, and how fast it went: the part of the story that depends on luck and on the clock."""

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ...schemas.facts import RECORDED, RESTORED
from ..store.changes import Changes, Outcome
from ..store.progress import RECENT, rate
from .data import Throughput, Worker

MOST_POINTS = 200


class LiveState(NamedTuple):
    """What an orchestrator knows of a worker now; `heartbeat` is a Unix time."""

    state: str
    rollout: str | None = None
    heartbeat: float | None = None


@dataclass(slots=True)
class _Sum:
    rollouts: int = 0
    failures: int = 0
    busy_seconds: float = 0.0
    cpu_seconds: float = 0.0
    last: float | None = None

    def add(self, outcome: Outcome) -> None:
        if outcome.outcome == RECORDED:
            self.rollouts += 1
        elif outcome.outcome != RESTORED:
            self.failures += 1
        self.busy_seconds += outcome.wall_seconds
        self.cpu_seconds += outcome.cpu_seconds
        self.last = outcome.ended if self.last is None else max(self.last, outcome.ended)


@dataclass(slots=True)
class WorkerStatistics:
    """The sums so far."""

    _sums: dict[str, _Sum] = field(default_factory=dict)
    _hosts: dict[str, str] = field(default_factory=dict)
    _ended: "array[float]" = field(default_factory=lambda: array("d"))
    _sessions: int = 0

    def take(self, added: Changes) -> None:
        """Add what is new."""
        self._hosts |= added.hosts
        self._sessions = added.sessions
        for outcome in added.outcomes:
            self._sums.setdefault(outcome.worker, _Sum()).add(outcome)
            if outcome.outcome == RECORDED:
                self._ended.append(outcome.ended)

    def workers(self, live: Mapping[str, LiveState]) -> tuple[Worker, ...]:
        """Return every worker by name; of one that is not in `live` the state is unknown."""
        names = sorted({*self._sums, *self._hosts, *live})
        return tuple(self._worker(name, live.get(name, LiveState("unknown"))) for name in names)

    def throughput(self) -> Throughput:
        """Return how the rollouts came."""
        ended = sorted(self._ended)
        marks = _marks(len(ended))
        return Throughput(
            rate=rate(self._ended[-RECENT:]),
            start=ended[0] if ended else None,
            seconds=tuple(ended[mark] - ended[0] for mark in marks),
            recorded=tuple(mark + 1 for mark in marks),
            sessions=self._sessions,
            failures=sum(each.failures for each in self._sums.values()),
        )

    def _worker(self, name: str, live: LiveState) -> Worker:
        done = self._sums.get(name, _Sum())
        return Worker(
            name=name,
            host=self._hosts.get(name, ""),
            rollouts=done.rollouts,
            failures=done.failures,
            busy_seconds=done.busy_seconds,
            cpu_seconds=done.cpu_seconds,
            last=done.last,
            state=live.state,
            rollout=live.rollout,
            heartbeat=live.heartbeat,
        )


def _marks(count: int) -> Sequence[int]:
    """Return at most `MOST_POINTS` of `count` positions, first and last among them.

    >>> _marks(3), len(_marks(1000)), _marks(1000)[-1]
    ([0, 1, 2], 200, 999)
    """
    if count <= MOST_POINTS:
        return list(range(count))
    return [round(number * (count - 1) / (MOST_POINTS - 1)) for number in range(MOST_POINTS)]

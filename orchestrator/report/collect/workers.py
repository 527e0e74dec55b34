"""Totals by worker and throughput over time: the part of the report data that differs from run to run."""

from array import array
from collections import deque
from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from ....schemas.result.facts import NO_FAILURE, RECORDED
from ...run.page.page_feed import LiveState
from ...store.changes import AttemptOutcome, Changes
from ...store.progress import RECENT, rate
from ..data.workers import FailedAttempt, Throughput, WorkerRow

MOST_POINTS = 200
MOST_WORKERS = 100
"""Workers in the data."""
MOST_FAILED = 50
"""Failed attempts in the data; the export lists all of them."""
LONGEST_REASON = 500
"""Characters of a reason."""


@dataclass(slots=True)
class _Totals:
    rollouts: int = 0
    failures: int = 0
    busy_seconds: float = 0.0
    cpu_seconds: float = 0.0
    last: float | None = None

    def add(self, outcome: AttemptOutcome) -> None:
        if outcome.outcome not in (RECORDED, *NO_FAILURE):
            self.failures += 1
        self.busy_seconds += outcome.wall_seconds
        self.cpu_seconds += outcome.cpu_seconds
        self.last = outcome.ended if self.last is None else max(self.last, outcome.ended)


@dataclass(slots=True)
class WorkerStatistics:
    """Totals by worker, the times of all recorded results, and the latest failed attempts.

    In rates and curves of a campaign in batches a result counts for as many rollouts as one has on average.
    """

    _totals: dict[str, _Totals] = field(default_factory=dict)
    _hosts: dict[str, str] = field(default_factory=dict)
    _ended: "array[float]" = field(default_factory=lambda: array("d"))
    _started: tuple[float, ...] = ()
    """Unix times of the sessions."""
    _system_failures: int = 0
    _failed: deque[FailedAttempt] = field(default_factory=lambda: deque(maxlen=MOST_FAILED))
    _in_batches: bool = False
    _rollouts: int = 0

    def add(self, changes: Changes) -> None:
        """Add the outcomes of new attempts."""
        self._hosts |= changes.hosts
        self._started = tuple(each.started for each in changes.sessions)
        self._in_batches = changes.header.config.batch > 1
        self._rollouts += sum(changes.rollouts.values())
        for worker, number in changes.of_workers.items():
            self._totals.setdefault(worker, _Totals()).rollouts += number
        for outcome in changes.outcomes:
            self._totals.setdefault(outcome.worker, _Totals()).add(outcome)
            if outcome.outcome == RECORDED:
                self._ended.append(outcome.ended)
            elif outcome.outcome not in NO_FAILURE:
                self._system_failures += outcome.kind == "system"
                self._failed.append(_failed_attempt(outcome))

    def rows(self, live: Mapping[str, LiveState], aside: Container[str] = ()) -> tuple[tuple[WorkerRow, ...], int]:
        """Return workers by name, and the number of those that are left out; `aside` are those that were set aside.

        A campaign of weeks has thousands: those that were set aside come first, then those that live, then those with
        most attempts. The state of a worker that `live` lacks is unknown.
        """
        names = {*self._totals, *self._hosts, *live}
        chosen = sorted(names, key=lambda name: (name not in aside, name not in live, -self._attempts(name), name))
        return tuple(self._row(name, live) for name in sorted(chosen[:MOST_WORKERS])), len(chosen[MOST_WORKERS:])

    def _attempts(self, name: str) -> int:
        found = self._totals.get(name)
        return found.rollouts + found.failures if found else 0

    def _row(self, name: str, live: Mapping[str, LiveState]) -> WorkerRow:
        return WorkerRow(
            name=name,
            host=self._hosts.get(name, ""),
            **asdict(self._totals.get(name, _Totals())),
            **live.get(name, LiveState("unknown"))._asdict(),
        )

    @property
    def _batch(self) -> float:
        """Rollouts of a result."""
        return self._rollouts / len(self._ended) if self._in_batches and self._ended else 1.0

    def throughput(self) -> Throughput:
        """Return the rollouts recorded over time."""
        ended = sorted(self._ended)  # results of several workers are not recorded in the order in which they ended
        positions = _positions(len(ended))
        return Throughput(
            rate=rate(self._ended[-RECENT:], self._started) * self._batch,
            start=ended[0] if ended else None,
            seconds=tuple(ended[at] - ended[0] for at in positions),
            recorded=tuple(round((at + 1) * self._batch) for at in positions),
            sessions=len(self._started),
            failures=sum(each.failures for each in self._totals.values()),
            system_failures=self._system_failures,
        )

    def ended(self) -> float | None:
        """Return the Unix time of the last result; None before the first one."""
        return max(self._ended, default=None)

    def failed_attempts(self) -> tuple[FailedAttempt, ...]:
        """Return the latest failed attempts, the last one first."""
        return tuple(reversed(self._failed))


def _failed_attempt(outcome: AttemptOutcome) -> FailedAttempt:
    reason = outcome.outcome[:LONGEST_REASON]
    return FailedAttempt(outcome.rollout, outcome.attempt, outcome.worker, outcome.kind, reason, outcome.ended)


def _positions(count: int) -> Sequence[int]:
    """Return at most `MOST_POINTS` of `count` positions, first and last among them.

    >>> _positions(3), len(_positions(1000)), _positions(1000)[-1]
    ([0, 1, 2], 200, 999)
    """
    if count <= MOST_POINTS:
        return list(range(count))
    return [round(number * (count - 1) / (MOST_POINTS - 1)) for number in range(MOST_POINTS)]

"""The part of the report data about the workers; names and reasons are untrusted text."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class WorkerRow:
    """One worker; state and heartbeat are known on the live page of a run only."""

    name: str
    host: str
    rollouts: int
    failures: int
    busy_seconds: float
    cpu_seconds: float
    last: float | None
    """Unix time of its last result."""
    state: str
    """"idle", "busy", "lost", ..., or "unknown"."""
    rollout: str | None
    heartbeat: float | None
    """Unix time."""


@dataclass(frozen=True, slots=True)
class Throughput:
    """Rollouts recorded over time."""

    rate: float
    """Rollouts per second over the last minute of work."""
    start: float | None
    """Unix time of the first result."""
    seconds: tuple[float, ...]
    recorded: tuple[int, ...]
    """`recorded[k]` rollouts are recorded `seconds[k]` after the start; at most 200 points."""
    sessions: int
    failures: int
    system_failures: int = 0
    """Failures of the system among them; 0 in a database that does not tell."""


@dataclass(frozen=True, slots=True)
class FailedAttempt:
    """One attempt without a result."""

    rollout: str
    attempt: int
    worker: str
    kind: str | None
    """"infrastructure" or "system"; None in an edited database."""
    reason: str
    ended: float
    """Unix time."""


@dataclass(frozen=True, slots=True)
class SetAsideRow:
    """A worker or host that was set aside."""

    kind: str
    """"worker" or "host"."""
    name: str
    times: int
    for_good: bool
    last: float
    """Unix time at which its last pause began."""
    reason: str

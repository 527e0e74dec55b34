"""The messages of a turn: they leave after its commit, so that no worker acts on what a crash could undo."""

import os
import secrets
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

from ...schemas.atomic import write_new
from ...schemas.batch import BatchRequest
from ...schemas.ids import Attempt
from ...schemas.link.messages import (
    Ack,
    Assign,
    AssignBatch,
    Cancel,
    HeartbeatInterval,
    Refuse,
    Release,
    Request,
    ResultHeader,
    RunFinished,
)
from ...schemas.link.seal import assignment_secret, is_proved
from ...schemas.rollout import RolloutRequest
from ..fleet.dispatch import events
from ..fleet.link.transport import Transport

# The secrets of the assignments. All of them follow from one key, which only orchestrators of this run read: after a
# restart the results of workers that went on are still proved. Without it, as after a restore from a backup, their
# attempts are made again.

KEY = "assignments.key"
"""In the run directory while the campaign runs."""
LENGTH = 32


class Assignments:
    """Secrets of the assignments of one run; `directory` is locked."""

    def __init__(self, directory: Path, run: str) -> None:
        self._path, self._run = directory / KEY, run
        self._key = _known_key(self._path) or _fresh_key(self._path)

    def secret(self, worker: str, attempt: Attempt) -> str:
        """Return the secret of an assignment."""
        return assignment_secret(self._key, self._run, str(attempt.rollout), attempt.number, worker)

    def proved(self, worker: str, header: ResultHeader) -> bool:
        """Whether a result or a failure was made by the worker of its assignment."""
        secret = assignment_secret(self._key, self._run, header.rollout, header.attempt, worker)
        return is_proved(secret, header)


def forget(directory: Path) -> None:
    """Remove the key of a run that is finished: its directory is handed on, with its evidence."""
    (directory / KEY).unlink(missing_ok=True)


def _known_key(path: Path) -> bytes | None:
    """Return the key; None where there is none that nobody else knows."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        # Who could read it could prove results; with a fresh key the attempts under way are made again.
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            return None
        key = file.read(LENGTH + 1)
    return key if len(key) == LENGTH else None


def _fresh_key(path: Path) -> bytes:
    key = secrets.token_bytes(LENGTH)
    path.unlink(missing_ok=True)
    write_new({path: (key, 0o600)})
    return key


class Outbox:
    """Messages to workers, in their order."""

    def __init__(self, transport: Transport, assignments: Assignments) -> None:
        self._transport, self._assignments = transport, assignments
        self._waiting: list[tuple[str, Request]] = []

    def assign(self, worker: str, attempt: Attempt, request: RolloutRequest | BatchRequest) -> None:
        """Give an attempt to a worker, with the secret that proves its result."""
        secret = self._assignments.secret(worker, attempt)
        if isinstance(request, BatchRequest):
            message: Request = AssignBatch(attempt=attempt.number, secret=secret, request=request)
        else:
            message = Assign(attempt=attempt.number, secret=secret, request=request)
        self._waiting.append((worker, message))

    def answer(self, action: events.Revoke | events.Acknowledge | events.Dismiss) -> None:
        """Stop an attempt, acknowledge it, or let a worker end that leaves."""
        match action:
            case events.Revoke(worker, attempt):
                self._waiting.append((worker, Cancel(rollout=str(attempt.rollout), attempt=attempt.number)))
            case events.Acknowledge(worker, attempt):
                self.acknowledge(worker, attempt)
            case events.Dismiss(worker):
                self._waiting.append((worker, Release()))

    def acknowledge(self, worker: str, attempt: Attempt) -> None:
        """Let a worker drop a result."""
        self._waiting.append((worker, Ack(rollout=str(attempt.rollout), attempt=attempt.number)))

    def refuse(self, worker: str, reason: str) -> None:
        """Send a worker away."""
        self._waiting.append((worker, Refuse(reason=reason)))

    def set_intervals(self, intervals: Mapping[str, float]) -> None:
        """Tell workers the seconds between their heartbeats."""
        # A message of its own: models are closed, so a new key in another message would be refused and not ignored.
        self._waiting += [(worker, HeartbeatInterval(seconds=each)) for worker, each in intervals.items()]

    def report_end(self, workers: Iterable[str]) -> None:
        """Report at once that the campaign has its certificate."""
        self._waiting += [(worker, RunFinished()) for worker in workers]
        self.send()

    def send(self) -> None:
        """Send everything."""
        for worker, message in self._waiting:
            self._transport.send(worker, message)
        self._waiting.clear()

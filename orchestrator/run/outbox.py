"""The messages of a turn: they leave after its commit, so that no worker acts on what a crash could undo."""

from collections.abc import Iterable, Mapping

from ...schemas.ids import Attempt
from ...schemas.link.messages import Ack, Assign, Cancel, HeartbeatInterval, Refuse, Release, Request, RunFinished
from ...schemas.rollout import RolloutRequest
from ..fleet.dispatch import events
from ..fleet.link.transport import Transport
from .assignments import Assignments


class Outbox:
    """Messages to workers, in their order."""

    def __init__(self, transport: Transport, assignments: Assignments) -> None:
        self._transport, self._assignments = transport, assignments
        self._waiting: list[tuple[str, Request]] = []

    def assign(self, worker: str, attempt: Attempt, request: RolloutRequest) -> None:
        """Give an attempt to a worker, with the secret that proves its result."""
        secret = self._assignments.secret(worker, attempt)
        self._waiting.append((worker, Assign(attempt=attempt.number, secret=secret, request=request)))

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

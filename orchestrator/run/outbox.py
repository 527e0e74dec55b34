"""The messages of a turn: they leave after its commit, so that no worker acts on what a crash could undo."""

from ...schemas.ids import Attempt
from ...schemas.messages import Ack, Assign, Cancel, Finished, Refuse, Release, Request
from ...schemas.rollout import RolloutRequest
from ..fleet.transport import Transport
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

    def cancel(self, worker: str, attempt: Attempt) -> None:
        """Stop an attempt."""
        self._waiting.append((worker, Cancel(rollout=str(attempt.rollout), attempt=attempt.number)))

    def acknowledge(self, worker: str, attempt: Attempt) -> None:
        """Let a worker drop a result."""
        self._waiting.append((worker, Ack(rollout=str(attempt.rollout), attempt=attempt.number)))

    def refuse(self, worker: str, reason: str) -> None:
        """Send a worker away."""
        self._waiting.append((worker, Refuse(reason=reason)))

    def dismiss(self, worker: str) -> None:
        """Let a worker end that leaves: nothing more is assigned to it."""
        self._waiting.append((worker, Release()))

    def finished(self, worker: str) -> None:
        """Report that the campaign has its certificate."""
        self._waiting.append((worker, Finished()))

    def send(self) -> None:
        """Send everything."""
        for worker, message in self._waiting:
            self._transport.send(worker, message)
        self._waiting.clear()

"""The results of one turn: admitted against their requests, and recorded once the dispatch machine has decided."""

from collections.abc import Container

from ...schemas.errors import EvidenceError
from ...schemas.facts import RECORDED, RESTORED
from ...schemas.ids import Attempt, RolloutId
from ...schemas.trajectory import Trajectory
from ..campaign.admission import admit
from ..campaign.ledger import Ledger, Work
from ..fleet import events
from ..fleet.transport import Result
from ..store.journal import Journal


class Results:
    """Admitted results by attempt; the dispatch machine receives their outcome alone, never their bytes."""

    def __init__(self, ledger: Ledger, journal: Journal) -> None:
        self._ledger, self._journal = ledger, journal
        self._columns = tuple(column.name for column in ledger.header.spec.columns)
        self._admitted: dict[Attempt, tuple[Result, Trajectory]] = {}

    def take(self, message: Result, *, open_rollouts: Container[RolloutId]) -> events.Delivered:
        """Take a result of an admitted worker; return the event for the dispatch machine."""
        attempt = Attempt(RolloutId.parse(message.header.rollout), message.header.attempt)
        # A result that is no longer needed is acknowledged unread, so that the worker drops it.
        error = self._admit(attempt, message) if attempt.rollout in open_rollouts else None
        return events.Delivered(message.at, message.worker, attempt, error)

    def _admit(self, attempt: Attempt, message: Result) -> str | None:
        """Keep a result until it is decided on; return the reason if it is refused."""
        header = message.header
        if header.outcome == "failed":
            return header.error or "the worker gave no reason"
        request = self._ledger.request(attempt.rollout)
        try:
            trajectory = admit(request, self._columns, message.payload, header.sha256)
        except EvidenceError as fault:
            return str(fault)
        self._admitted[attempt] = message, trajectory
        return None

    def record(self, worker: str, attempt: Attempt) -> Work:
        """Write an admitted result; return the rollouts that are wanted and unwanted from now on."""
        message, trajectory = self._admitted[attempt]
        header, rollout = message.header, attempt.rollout
        outcome = RESTORED if self._ledger.restores(rollout) else RECORDED
        work = self._ledger.record(rollout, message.payload, trajectory, header.sha256)
        self._journal.attempt_ended(attempt, worker, outcome, header.cpu_seconds, header.wall_seconds)
        return work

    def clear(self) -> None:
        """Drop what is decided on."""
        self._admitted.clear()

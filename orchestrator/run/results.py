"""The results of one turn: admitted against their requests, and recorded once the dispatch machine has decided."""

import hashlib
from collections.abc import Callable, Container, Iterable, Iterator

import numpy as np

from ...schemas.batch import BatchRequest, largest_result, work_of
from ...schemas.errors import EvidenceError, UnusableTrajectoryError
from ...schemas.failure import Failure
from ...schemas.ids import Attempt, RolloutId, WorkId, first_of, parse_work
from ...schemas.link.messages import MAX_RESULT
from ...schemas.result.facts import RECORDED, RESTORED
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.batch import Batch
from ...schemas.trajectory.trajectory import Trajectory
from ...schemas.trajectory.visual import Floats
from ..campaign.admission import Admission, Compared, admit_either
from ..campaign.ledger import Ledger, Scored, Work
from ..fleet.dispatch import events
from ..fleet.link.transport import Result
from ..store.journal import Journal
from ..store.rows import work_name
from .decoder import LARGE, Decoded, Decoder
from .doubted_rollouts import Review

Events = tuple[events.Delivered | events.HandedBack, ...]


class Results:
    """Admitted results by attempt; the dispatch machine receives their outcome alone, never their bytes."""

    def __init__(self, ledger: Ledger, journal: Journal, review: Review, done: Callable[[Decoded], None]) -> None:
        self._ledger, self._journal, self._review = ledger, journal, review
        self._admission = Admission(ledger)
        self._decoder = Decoder(self._admission.columns, done)
        self._grids = Grids()
        self._admitted: dict[Attempt, tuple[Result, Trajectory | Scored]] = {}
        self._doubtful: set[Attempt] = set()
        """Those of the admitted ones with a time grid that is not known."""

    @property
    def undecided_since(self) -> float:
        """Time of receipt of the oldest result that is still decoded; infinite without one."""
        return self._decoder.oldest

    def take(self, message: Result | Decoded, *, open_rollouts: Container[WorkId]) -> Events:
        """Take a result of an admitted worker; return the events for the dispatch machine.

        A large one is decoded beside the loop first: there are none then, and `done` gets the result again.
        """
        if isinstance(message, Decoded):
            self._decoder.finish(message)
            result, decoded = message.result, message.found
        else:
            result, decoded = message, None
        attempt = result.attempt
        if result.header.outcome == "handed_back":
            return (events.HandedBack(result.at, result.worker, attempt),)
        header, failure, is_open = result.header, None, attempt.rollout in open_rollouts
        if header.outcome == "done" and len(result.payload) > (most := self._largest(attempt.rollout, is_open=is_open)):
            size = f"{len(result.payload)} bytes, more than the {most} of a result"
            failed = Failure("system", f"the trajectory's file has {size}")
            return (events.Delivered(result.at, result.worker, attempt, failed),)
        if decoded is None and is_open and header.outcome == "done" and len(result.payload) > LARGE:
            self._decoder.submit(result, self.request(attempt.rollout))
            return ()
        if header.outcome == "failed":
            # The worker has decided the kind, by the place of the fault; it cannot be found out here.
            failure = Failure(header.kind or "infrastructure", header.error or "the worker gave no reason")
        elif is_open:
            failure = self._admit(attempt, result, decoded)
        # A result that is no longer needed is acknowledged unread, so that the worker drops it.
        doubtful = attempt in self._doubtful
        each = self._each(attempt)
        return (
            events.Delivered(result.at, result.worker, attempt, failure, header.sha256, doubtful=doubtful, each=each),
        )

    def _each(self, attempt: Attempt) -> tuple[bytes, ...]:
        """Return the digest of each rollout of an admitted batch."""
        _, found = self._admitted.get(attempt, (None, None))
        return found.batch.digests if isinstance(found, Scored) else ()

    def _largest(self, rollout: WorkId, *, is_open: bool) -> int:
        spec, config = self._ledger.header.spec, self._ledger.config
        if is_open:
            return largest_result(spec, self.request(rollout))
        return min(spec.largest_file * config.batch, MAX_RESULT)

    def _admit(
        self, attempt: Attempt, message: Result, decoded: Trajectory | Batch | EvidenceError | None
    ) -> Failure | None:
        """Keep a result until it is decided on; return the failure of the attempt if it is refused."""
        if isinstance(decoded, EvidenceError):  # not raised here: its frame would keep the result, and it the frame
            return _refused(decoded)
        rollout, sha256 = attempt.rollout, message.header.sha256
        try:
            request = self.request(rollout)
            if decoded is None:
                decoded = admit_either(request, self._admission.columns, message.payload, sha256)
            found: Trajectory | Scored
            if isinstance(decoded, Batch):
                assert isinstance(request, BatchRequest)
                found, compared = self._admission.score(first_of(rollout), request, decoded)
            elif self._review.request(rollout):
                found, compared = decoded, "same"
            else:
                found, compared = decoded, self._admission.check(first_of(rollout), decoded)
        except EvidenceError as fault:
            return _refused(fault)
        self._admitted[attempt] = message, found
        if self._is_doubted(compared) and not self._grids.is_known(_grid(found), message.worker, rollout):
            self._doubtful.add(attempt)
        return None

    def _is_doubted(self, compared: Compared) -> bool:
        """Whether a result with an unknown time grid is simulated once more before it counts."""
        # What nothing can simulate once more cannot be doubted.
        if compared == "same" or self._ledger.header.spec.repeated == "nowhere":
            return False
        return compared == "first of a pair" or not self._grids.vary

    def request(self, work: WorkId) -> RolloutRequest | BatchRequest:
        """Return the request for a rollout or a batch that is wanted."""
        return self._review.request(work) or self._ledger.request(first_of(work))

    def work(self, rollout: RolloutId) -> WorkId:
        """Return the rollout that the ledger wants, or the batch that it wants by the first one."""
        return work_of(self._ledger.request(rollout))

    def record(self, worker: str, attempt: Attempt) -> Work:
        """Write an admitted result; return the rollouts that are wanted and unwanted from now on."""
        message, found = self._admitted[attempt]
        header, rollout = message.header, first_of(attempt.rollout)
        if self._review.request(attempt.rollout) is not None:
            self._review.take(worker, attempt, header.sha256, message.payload)
            return Work()
        outcome = RESTORED if self._ledger.restores(rollout) else RECORDED
        if attempt in self._doubtful:
            self._grids.take(_grid(found))
        work = self._ledger.record(rollout, message.payload, found, header.sha256)
        self._journal.attempts.ended(attempt, worker, outcome, header.cpu_seconds, header.wall_seconds)
        return work

    def failed(self, worker: str, attempt: Attempt) -> Iterator[events.Fail]:
        """Yield the rollouts that have failed in an admitted batch, each as an attempt of its own."""
        _, found = self._admitted[attempt]
        if not isinstance(found, Scored):
            return
        request = self.request(attempt.rollout)
        assert isinstance(request, BatchRequest)
        for place, reason in sorted(found.scores.failures.items()):
            yield events.Fail(worker, Attempt(request.rollouts[place], attempt.number), Failure("system", reason))

    def recorders(self, wanted: Iterable[WorkId]) -> dict[WorkId, str]:
        """Return the worker that recorded the original of each rollout that repeats one."""
        found = {
            each: self._journal.attempts.worker_of(original) for each in wanted if (original := self._original(each))
        }
        return {each: worker for each, worker in found.items() if worker is not None}

    def _original(self, work: WorkId) -> WorkId | None:
        """Return what a rollout or a batch repeats, as its attempts are called; None if it is a new one."""
        if self._review.request(work):
            return work
        original = self._ledger.closing.original(first_of(work))
        # It may be in a batch, whose attempts are called otherwise.
        return original and parse_work(work_name(self._journal.rollout(original).path))

    def clear(self) -> None:
        """Drop what is decided on."""
        self._admitted.clear()
        self._doubtful.clear()


def _refused(fault: EvidenceError) -> Failure:
    """Return the failure of an attempt whose result is refused."""
    return Failure("system" if isinstance(fault, UnusableTrajectoryError) else "infrastructure", str(fault))


# Time grids. One that no other rollout has is doubted before it becomes a fact.
#
# A result is recorded at once only if its grid is known: two workers have sent it, one has repeated it, or it was
# recorded. Stamps that one attempt alone gives would move the borders of windows, and of a pair, which needs one grid,
# nobody could tell which of the two is at fault. A system with steps of its own for every start is recognised by its
# grids that repetitions confirm.

MOST = 1000
"""Grids that are kept, the latest: a system with steps of its own for every start has as many as starts."""

VARIOUS = 3
"""Grids that repetitions have confirmed, after which a grid of its own is how this system is."""


class Grids:
    """The grids of one session by their digests, each with who sent it first, for which rollout; None once it is known.

    A worker that sends it again for the same rollout has repeated it.
    """

    def __init__(self) -> None:
        self._senders: dict[str, tuple[str, WorkId] | None] = {}
        self._confirmed = 0

    @property
    def vary(self) -> bool:
        """Whether the system has grids of its own for its starts, so that an unknown one is no sign of a fault."""
        return self._confirmed >= VARIOUS

    def is_known(self, times: Floats, worker: str, rollout: WorkId) -> bool:
        """Whether the grid (T,) of a worker's result is known; afterwards that worker has sent it."""
        grid, new = _digest(times), ("", rollout)
        first = self._senders.pop(grid, new)
        # Two workers, or one that repeats it: a worker alone may be wrong in the same way for every rollout.
        known = first is None or (first is not new and (first[0] != worker or first[1] == rollout))
        self._senders[grid] = (
            None if known else (worker, rollout)
        )  # the last one: the oldest is the first to be forgotten
        if len(self._senders) > MOST:
            del self._senders[next(iter(self._senders))]
        return known

    def take(self, times: Floats) -> None:
        """Know the grid (T,) of a result that was doubted and is recorded: its repetition gave the same."""
        self._confirmed += 1
        self._senders[_digest(times)] = None


def _grid(found: Trajectory | Scored) -> Floats:
    return found.batch.time if isinstance(found, Scored) else found.samples[:, 0]


def _digest(times: Floats) -> str:
    return hashlib.sha256(np.ascontiguousarray(times).tobytes()).hexdigest()

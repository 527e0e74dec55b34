"""The review before the certificate: rollouts whose workers are doubted are simulated again.

These are all that outvoted workers recorded, and those of which two workers have sent different results that no third
one has decided on: their tests were no longer needed, or the run ended in between. Of the latter the results of before
count as opinions, so that one of the two is outvoted, or the campaign ends as it does without a majority.

Nothing is recorded a second time. A result that differs stays what the campaign decided on; the certificate then
refutes that the workers are honest.
"""

from collections.abc import Callable

from ...schemas.batch import BatchRequest, file_of
from ...schemas.ids import Attempt, WorkId, first_of, rollouts_of
from ...schemas.result.block_facts import BatchFact
from ...schemas.result.facts import RolloutFact
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.batch import read_batch
from ...schemas.trajectory.reduced import read_stored
from ..campaign.ledger import Ledger
from ..campaign.seeds import is_chosen
from ..fleet.dispatch.opinions import PARTLY
from ..store.files import read_evidence, relative_path
from ..store.journal import Journal
from .trust import doubted


class Review:
    """The rollouts that are simulated again, by their requests; empty before the campaign is decided."""

    def __init__(self, ledger: Ledger, journal: Journal, print_line: Callable[[str], None]) -> None:
        self._ledger, self._journal, self._print_line = ledger, journal, print_line
        self._requests: dict[WorkId, RolloutRequest | BatchRequest] = {}
        self._disputed: frozenset[WorkId] = frozenset()

    def __len__(self) -> int:
        return len(self._requests)

    def begin(self) -> list[WorkId]:
        """Return the rollouts that are still to be simulated again, and take them in."""
        disputed, suspects = doubted(self._journal)
        self._disputed = frozenset(disputed)
        # First the disputes: they decide who else is outvoted.
        found = disputed or suspects
        if found:
            whose = "on which two workers differ" if disputed else "of outvoted workers"
            self._print_line(f"{sum(map(rollouts_of, found)):,} rollouts {whose} are simulated again")
        for work in found:
            self._requests[work] = self._ledger.request_again(work)
        return found

    def request(self, work: WorkId) -> RolloutRequest | BatchRequest | None:
        """Return the request for a rollout or a batch under review; None for every other one."""
        return self._requests.get(work)

    def compares(self, work: WorkId) -> bool:
        """Whether a rollout or a batch gets a second opinion before it is recorded: a damaged file has its digest."""
        if work in self._requests:
            return work in self._disputed
        first = first_of(work)
        return not self._ledger.restores(first) and is_chosen(self._ledger.header, first)

    def take(self, worker: str, attempt: Attempt, sha256: str, payload: bytes) -> None:
        """Write the digest of a result."""
        # Nothing is recorded again: bounds rest on the first result, and the certificate says where it differs.
        request = self._requests.pop(attempt.rollout)
        fact = self._journal.file(relative_path(file_of(request))) if isinstance(request, BatchRequest) else None
        if fact is not None and fact.sha256 != sha256 and self._same(fact, attempt, worker, payload):
            sha256 = fact.sha256
        self._journal.attempts.opinion("reviewed", attempt, worker, sha256)

    def _same(self, fact: RolloutFact | BatchFact, attempt: Attempt, worker: str, payload: bytes) -> bool:
        """Whether a batch and the recorded one differ in failures alone."""
        kept = read_evidence(self._journal.directory, fact.path, fact.sha256)
        before, now = read_stored(kept).batch, read_batch(payload).batch
        if now.failures.keys() - before.failures.keys():
            # As a rollout alone that fails in its review: a failure of the system, and no contradiction.
            self._journal.attempts.ended(attempt, worker, PARTLY)
        return all(one == other for one, other in zip(before.digests, now.digests, strict=True) if one and other)

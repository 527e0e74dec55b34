"""The review before the certificate: rollouts whose workers are doubted are simulated again.

These are all that outvoted workers recorded, and those of which two workers have sent different results that no third
one has decided on: their tests were no longer needed, or the run ended in between. Of the latter the results of before
count as opinions, so that one of the two is outvoted, or the campaign ends as it does without a majority.

Nothing is recorded a second time. A result that differs stays what the campaign decided on; the certificate then
refutes that the workers are honest.
"""

from collections.abc import Callable

from ...schemas.ids import Attempt, RolloutId
from ...schemas.rollout import RolloutRequest
from ..campaign.ledger import Ledger
from ..campaign.seeds import is_chosen
from ..store.journal import Journal
from .trust import doubted


class Review:
    """The rollouts that are simulated again, by their requests; empty before the campaign is decided."""

    def __init__(self, ledger: Ledger, journal: Journal, print_line: Callable[[str], None]) -> None:
        self._ledger, self._journal, self._print_line = ledger, journal, print_line
        self._template = ledger.header.template
        self._requests: dict[RolloutId, RolloutRequest] = {}
        self._disputed: frozenset[RolloutId] = frozenset()

    def __len__(self) -> int:
        return len(self._requests)

    def begin(self) -> list[RolloutId]:
        """Return the rollouts that are still to be simulated again, and take them in."""
        disputed, suspects = doubted(self._journal)
        self._disputed = frozenset(disputed)
        if disputed:
            self._print_line(f"{len(disputed):,} rollouts on which two workers differ are simulated again")
        elif suspects:
            self._print_line(f"{len(suspects):,} rollouts of outvoted workers are simulated again")
        # First the disputes: they decide who else is outvoted.
        found = disputed or suspects
        for rollout in found:
            start = self._journal.proposal(rollout.problem, rollout.test).proposal.x
            seed = self._ledger.deciders[rollout.problem].seed(rollout)
            self._requests[rollout] = self._template.request(rollout, start, seed)
        return found

    def request(self, rollout: RolloutId) -> RolloutRequest | None:
        """Return the request for a rollout under review; None for every other one."""
        return self._requests.get(rollout)

    def compares(self, rollout: RolloutId) -> bool:
        """Whether a rollout gets a second opinion before it is recorded: a damaged file has its digest."""
        if rollout in self._requests:
            return rollout in self._disputed
        return not self._ledger.restores(rollout) and is_chosen(self._ledger.header, rollout)

    def take(self, worker: str, attempt: Attempt, sha256: str) -> None:
        """Write the digest of a result."""
        # Nothing is recorded again: bounds rest on the first result, and the certificate says where it differs.
        del self._requests[attempt.rollout]
        self._journal.attempts.opinion("reviewed", attempt, worker, sha256)

"""The review of outvoted workers: all that they recorded is simulated again before the certificate.

Nothing of it is recorded a second time. A result that differs stays what the campaign decided on; the certificate then
refutes that the workers are honest.
"""

from ...schemas.ids import Attempt, RolloutId
from ...schemas.rollout import RolloutRequest
from ..campaign.ledger import Ledger
from ..campaign.second_opinion import is_chosen
from ..store.journal import Journal


class Review:
    """The rollouts that are simulated again, by their requests; empty before the campaign is decided."""

    def __init__(self, ledger: Ledger, journal: Journal) -> None:
        self._ledger, self._journal = ledger, journal
        self._template = ledger.header.template
        self._requests: dict[RolloutId, RolloutRequest] = {}

    def __len__(self) -> int:
        return len(self._requests)

    def begin(self) -> list[RolloutId]:
        """Return the rollouts that are still to be simulated again, and take them in."""
        found = self._journal.attempts.suspects()
        for rollout in found:
            start = self._journal.proposal(rollout.problem, rollout.test).proposal.x
            self._requests[rollout] = self._template.request(rollout, start, self._journal.rollout(rollout).seed)
        return found

    def request(self, rollout: RolloutId) -> RolloutRequest | None:
        """Return the request for a rollout under review; None for every other one."""
        return self._requests.get(rollout)

    def compares(self, rollout: RolloutId) -> bool:
        """Whether a rollout gets a second opinion before it is recorded: a damaged file has its digest."""
        known = rollout in self._requests or self._ledger.restores(rollout)
        return not known and is_chosen(self._ledger.header, rollout)

    def take(self, worker: str, attempt: Attempt, sha256: str) -> None:
        """Write the digest of a result."""
        del self._requests[attempt.rollout]
        self._journal.attempts.opinion("reviewed", attempt, worker, sha256)

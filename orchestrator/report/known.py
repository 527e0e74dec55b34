"""What is known of a campaign after some looks; a look adds what is new."""

from pathlib import Path

from ...schemas.certificate import Certificate
from ...schemas.errors import JournalError
from ...schemas.facts import Header, RolloutFact
from ..campaign.plan import plans
from ..certificate import files
from ..store.changes import ChangeReader, Changes
from . import rollouts
from .data import Rollout
from .problem import ProblemCollector
from .workers import WorkerStatistics

MOST = 1000
"""Counterexamples that a story lists; the file beside a report has them all."""


class Known:
    """The sums of the looks so far; after an error it is of no more use.

    Raises:
        PerfboundError: there is no campaign in the directory, or it cannot be read.

    """

    def __init__(self, directory: Path) -> None:
        self.crew = WorkerStatistics()
        self.counterexamples: tuple[Rollout, ...] = ()
        self._directory = directory
        self._since = ChangeReader(directory)
        self._violations: list[RolloutFact] = []
        self.certificate = files.read(directory)  # before the facts: with a certificate, they are all there
        added = self._since.look()
        self.header: Header = added.header
        found = plans(self.header.config, self.header.spec)
        self.told: dict[str, ProblemCollector] = {
            name: ProblemCollector(self.header, plan) for name, plan in found.items()
        }
        self._add(added)
        self._check(self.certificate)

    def look(self) -> None:
        """Add what is new."""
        certificate = self.certificate or files.read(self._directory)
        self._add(self._since.look())
        self._check(certificate)
        self.certificate = certificate

    @property
    def violations(self) -> int:
        """Number of rollouts with robustness below 0."""
        return len(self._violations)

    def _add(self, added: Changes) -> None:
        """Add facts in the order in which they were written."""
        try:
            for fact in added.decisions:
                self.told[fact.problem].take(fact)
            for problem, number in added.rollouts.items():
                self.told[problem].rollouts += number
        except (KeyError, ValueError) as error:
            raise JournalError(
                f"{self._directory}: the facts contradict each other ({error}); restore the database from a copy"
            ) from None
        self.crew.take(added)
        if added.violations:
            self._violations += added.violations
            self._violations.sort(key=lambda fact: (fact.robustness, fact.rollout))
            self.counterexamples = tuple(self._rollout(fact) for fact in self._violations[:MOST])

    def _rollout(self, fact: RolloutFact) -> Rollout:
        start = self.told[fact.rollout.problem].starts[fact.rollout.test]
        return rollouts.rollout(self._directory, fact, start)

    def _check(self, certificate: Certificate | None) -> None:
        if certificate and certificate.predicate.campaign.config_sha256 != self.header.config_sha256:
            raise JournalError(
                f"{self._directory}: the certificate is that of another campaign than the database; restore one of them"
            )

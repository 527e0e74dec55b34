"""The restoration of trajectory files that a crash of the machine damaged: the same seed gives the same file."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.ids import RolloutId
from ...schemas.result.block_facts import BatchFact
from ...schemas.result.facts import RolloutFact
from ...schemas.trajectory.batch import read_batch, with_failures
from ...schemas.trajectory.reduced import Scores, reduced_file
from ..store import files as evidence
from .ports import FileStore, RecordedRollouts


class Restoration:
    """The recorded rollouts whose files are missing or damaged, until each is simulated again."""

    def __init__(
        self,
        directory: Path,
        recorded: RecordedRollouts | None = None,
        *,
        discarded: Iterable[str] = (),
        whole: bool = False,
    ) -> None:
        """Check every recorded file and remove those without a fact; without `recorded`, nothing is damaged.

        `discarded` are the paths of the files that discards have kept.
        """
        self._directory = directory
        self._damaged: dict[RolloutId, list[RolloutFact | BatchFact]] = {}
        self._starts: dict[tuple[str, int], tuple[float, ...]] = {}
        if recorded is None:
            return
        facts = recorded.recorded()
        # A crash between a file and its commit leaves a file that no fact names: its rollout is simulated again.
        evidence.sweep(directory, {fact.path for fact in facts}.union(discarded))
        listed = ((fact.path, fact.size, fact.sha256) for fact in facts)
        paths = set(evidence.damaged(directory, listed, digests=None if whole else evidence.NEWEST))
        for fact in facts:
            if fact.path in paths:
                self._damaged.setdefault(fact.rollout, []).append(fact)
        tests = {
            (fact.rollout.problem, test)
            for each in self._damaged.values()
            for fact in each
            for test in (fact.tests if isinstance(fact, BatchFact) else (fact.rollout.test,))
        }
        self._starts = {test: recorded.proposal(*test).proposal.x for test in tests}

    def __len__(self) -> int:
        return sum(map(len, self._damaged.values()))

    def __contains__(self, rollout: RolloutId) -> bool:
        return rollout in self._damaged

    @property
    def wanted(self) -> list[RolloutId]:
        """Every rollout, or the first one of every batch, that is to be simulated again."""
        return sorted(self._damaged)

    def start(self, rollout: RolloutId) -> tuple[float, ...]:
        """Return the start of a damaged rollout, whose test may be closed."""
        return self._starts[rollout[:2]]

    def batch(self, rollout: RolloutId) -> BatchFact | None:
        """Return the damaged batch that begins with a rollout, if there is one."""
        found = self._damaged.get(rollout, [None])[0]
        return found if isinstance(found, BatchFact) else None

    def starts(self, batch: BatchFact) -> list[tuple[float, ...]]:
        """Return the start of each test of a damaged batch."""
        return [self._starts[batch.rollout.problem, test] for test in batch.tests]

    def restore(self, rollout: RolloutId, payload: bytes, files: FileStore) -> None:
        """Write a damaged file again.

        Raises:
            PerfboundError: the new bytes are not the recorded ones.

        """
        fact = self._damaged[rollout][0]
        if isinstance(fact, BatchFact):
            payload = _as_recorded(payload, fact)
        sha256 = hashlib.sha256(payload).hexdigest()
        # The chain has the recorded digest: other bytes would make the evidence contradict the certificate.
        if sha256 != fact.sha256:
            raise PerfboundError(
                f"{self._directory / fact.path}: damaged, and simulated again it has the sha256 {sha256[:12]}..., not "
                f"the recorded {fact.sha256[:12]}..., so it does not follow from its seed alone, or "
                "this machine computes other floating-point results; "
                "restore the file from a copy"
            )
        files.write(evidence.inside(self._directory, fact.path), payload)
        del self._damaged[rollout][0]
        if not self._damaged[rollout]:
            del self._damaged[rollout]


def _as_recorded(payload: bytes, fact: BatchFact) -> bytes:
    """Return the file of a batch that was simulated again as it was recorded, if the rollouts are the same."""
    if fact.failures and hashlib.sha256(payload).hexdigest() != fact.sha256:
        # Rollouts that failed then may succeed now: the recorded file has zeros and the reason in their places.
        payload = with_failures(payload, dict(fact.failures))
    if fact.kept is None:
        return payload
    if len(read_batch(payload).batch.failures) > len(fact.failures):
        return payload  # one that succeeded then has failed now
    assert fact.robustness is not None, "only batches with a robustness are reduced"
    scores = Scores(fact.robustness, fact.by_tolerance, fact.ended, dict(fact.failures))
    return reduced_file(payload, fact.kept, scores)

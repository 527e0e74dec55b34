"""The ports of a ledger: stores of facts and of files, and the recorded rollouts that are read back from them."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from ...schemas.ids import RolloutId
from ...schemas.result.block_facts import BatchFact, StoredFact
from ...schemas.result.facts import Header, ProposalFact, RolloutFact
from ...schemas.rollout import WithinBatch
from ...schemas.trajectory.batch import Batch, BatchFile, digest_of, read_batch
from ...schemas.trajectory.reduced import Reduced, read_stored
from ...schemas.trajectory.trajectory import Trajectory, decode
from ..store import files as evidence


class FactStore(Protocol):
    """The facts of a campaign in their order: the journal, or a list in memory while evidence is verified."""

    header: Header

    def transaction(self) -> AbstractContextManager[None]:
        """Make all facts added inside durable together."""
        ...

    def add(self, fact: StoredFact) -> None:
        """Write one fact."""
        ...

    def facts(self) -> Iterator[StoredFact]:
        """Yield all facts in their order."""
        ...

    def rollout(self, rollout: RolloutId) -> RolloutFact:
        """Return a recorded rollout; inside `transaction`."""
        ...

    def batch_of(self, rollout: RolloutId) -> BatchFact | None:
        """Return the batch of a recorded rollout; None for one without; inside `transaction`."""
        ...

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one; inside `transaction`."""
        ...


class RecordedRollouts(Protocol):
    """The recorded rollouts of a campaign, of which a resume checks the files."""

    def recorded(self) -> list[RolloutFact | BatchFact]:
        """Return all recorded rollouts and batches, the newest first."""
        ...

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one; inside or outside a transaction."""
        ...


class FileStore(Protocol):
    """The trajectory files of a campaign; written inside a `with` block, durable at its end."""

    def write(self, path: Path, data: bytes) -> None:
        """Take a file."""
        ...

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None: ...


# Recorded rollouts, read back


class Recorded:
    """Starts and trajectories of recorded rollouts, read from the disk; those of open tests are kept in memory.

    Raises:
        EvidenceError: a file is missing or damaged.

    """

    def __init__(self, directory: Path, store: FactStore) -> None:
        self._directory, self._store = directory, store
        self._kept: dict[RolloutId, Trajectory] = {}
        self._batches: dict[str, tuple[BatchFact, Batch]] = {}
        """By the digests of their files."""
        self._file: tuple[str, BatchFile[Batch] | BatchFile[Reduced]] | None = None
        """The batch that was read last, by the digest of its file: its rollouts are read one after the other."""

    def keep(self, rollout: RolloutId, trajectory: Trajectory) -> None:
        """Keep the trajectory of a rollout until its test is observed."""
        self._kept[rollout] = trajectory

    def keep_batch(self, fact: BatchFact, batch: Batch) -> None:
        """Keep a batch until its block is observed, or its rollouts until their tests are."""
        self._batches[fact.sha256] = fact, batch

    def drop(self, files: Iterable[str]) -> None:
        """Forget batches, by the digests of their files: what they have is observed."""
        for sha256 in files:
            self._batches.pop(sha256, None)

    def kept(self, fact: RolloutFact) -> Trajectory:
        """Return the trajectory of a rollout of an open test; it stays in memory."""
        # After a restart the rollouts of a test may be recorded and the test not yet observed: they are read again.
        if fact.rollout not in self._kept:
            self._kept[fact.rollout] = self.read(fact)
        return self._kept[fact.rollout]

    def take(self, fact: RolloutFact) -> Trajectory:
        """Return the trajectory of a rollout whose test is observed now."""
        return self._kept.pop(fact.rollout, None) or self.read(fact)

    def start(self, rollout: RolloutId) -> tuple[float, ...]:
        """Return the start of a rollout."""
        return self._store.proposal(rollout.problem, rollout.test).proposal.x

    def trajectory(self, rollout: RolloutId) -> Trajectory:
        """Return the trajectory of a rollout."""
        return self.read(self._store.rollout(rollout))

    def digest(self, rollout: RolloutId) -> bytes:
        """Return the digest of the samples of a rollout, see `digest_of`; of one of a batch its fact has it."""
        fact = self._store.rollout(rollout)
        return bytes.fromhex(fact.sha256) if fact.batch else digest_of(self.read(fact))

    def read(self, fact: RolloutFact) -> Trajectory:
        """Return the trajectory that a fact names; raises TrajectoryError if its samples were not kept."""
        if not fact.batch:
            return decode(evidence.read_evidence(self._directory, fact.path, fact.sha256))
        if fact.batch in self._batches:
            kept, batch = self._batches[fact.batch]
            return batch.trajectory(kept.place(fact.rollout))
        return self._batch_file(fact).alone(fact.rollout).trajectory

    def within(self, rollout: RolloutId) -> WithinBatch | None:
        """Return the batch that has to be repeated to repeat a rollout; None for one that repeats alone."""
        fact = self._store.batch_of(rollout) if self._store.header.spec.batch_is_the_unit else None
        if fact is None:
            return None
        # Not from its file: that of the last batch is in its place at the end of the transaction.
        starts = [self.start(rollout._replace(test=test)) for test in fact.tests]
        return WithinBatch(x=tuple(starts), seeds=tuple(fact.seeds.tolist()), place=fact.place(rollout))

    def _batch_file(self, fact: RolloutFact) -> BatchFile[Batch] | BatchFile[Reduced]:
        if self._file is None or self._file[0] != fact.batch:
            data = evidence.read_evidence(self._directory, fact.path, fact.batch)
            self._file = fact.batch, read_stored(data)
        return self._file[1]

    def batch(self, fact: BatchFact) -> Batch:
        """Return the batch that a fact names."""
        if fact.sha256 in self._batches:
            return self._batches[fact.sha256][1]
        return read_batch(evidence.read_evidence(self._directory, fact.path, fact.sha256)).batch

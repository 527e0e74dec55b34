"""The ports of a ledger: stores of facts and of files, and the recorded rollouts that are read back from them."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from ...schemas.ids import RolloutId
from ...schemas.result.facts import Fact, Header, ProposalFact, RolloutFact
from ...schemas.trajectory.trajectory import Trajectory, decode
from ..store import files as evidence


class FactStore(Protocol):
    """The facts of a campaign in their order: the journal, or a list in memory while evidence is verified."""

    header: Header

    def transaction(self) -> AbstractContextManager[None]:
        """Make all facts added inside durable together."""
        ...

    def add(self, fact: Fact) -> None:
        """Write one fact."""
        ...

    def facts(self) -> Iterator[Fact]:
        """Yield all facts in their order."""
        ...

    def rollout(self, rollout: RolloutId) -> RolloutFact:
        """Return a recorded rollout; inside `transaction`."""
        ...

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one; inside `transaction`."""
        ...


class RecordedRollouts(Protocol):
    """The recorded rollouts of a campaign, of which a resume checks the files."""

    def recorded(self) -> list[RolloutFact]:
        """Return all recorded rollouts, the newest first."""
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

    def keep(self, rollout: RolloutId, trajectory: Trajectory) -> None:
        """Keep the trajectory of a rollout until its test is observed."""
        self._kept[rollout] = trajectory

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

    def read(self, fact: RolloutFact) -> Trajectory:
        """Return the trajectory that a fact names."""
        return decode(evidence.read_evidence(self._directory, fact.path, fact.sha256))

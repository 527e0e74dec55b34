"""The ports of a ledger: stores of facts and of files, in the run directory, in memory, or without effect."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from ...schemas.ids import RolloutId
from ...schemas.result.facts import Fact, Header, ProposalFact, RolloutFact


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

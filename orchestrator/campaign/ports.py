"""Where a ledger puts facts and files: the run directory, or nowhere when it only verifies."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from ...schemas.facts import Fact, Header, ProposalFact, RolloutFact


class FactStore(Protocol):
    """Where facts are written: the journal, or what remembers them while evidence is verified."""

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

    def recorded(self) -> list[RolloutFact]:
        """Return all recorded rollouts, the newest first."""
        ...

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one."""
        ...


class FileStore(Protocol):
    """Where trajectory files are put."""

    def write(self, path: Path, data: bytes) -> None:
        """Take a file."""
        ...

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None: ...

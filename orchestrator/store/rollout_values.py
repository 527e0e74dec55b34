"""The robustness of recorded rollouts that were added to a campaign database since the last call."""

from pathlib import Path
from typing import NamedTuple

from .readonly import snapshot

_ADDED = """
    SELECT seq, problem, variant, test, robustness FROM each_rollout
    WHERE seq > ? AND robustness IS NOT NULL ORDER BY seq
"""


class AddedValue(NamedTuple):
    """The robustness of one rollout, clipped."""

    seq: int
    problem: str
    variant: str
    test: int
    robustness: float


class RolloutValueReader:
    """Reads the robustness of the rollouts of a campaign in increments; used by one thread at a time."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._seq = 0

    def read(self) -> list[AddedValue]:
        """Return what was added, in the order of the database; rollouts without a robustness are left out.

        Raises:
            JournalError: there is no campaign, or its database is damaged.
            OSError: the disk is full or fails.

        """
        with snapshot(self._directory) as connection:
            found = [AddedValue(*row) for row in connection.execute(_ADDED, [self._seq])]
        self._seq = max((each.seq for each in found), default=self._seq)
        return found

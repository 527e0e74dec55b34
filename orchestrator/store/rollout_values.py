"""The robustness of recorded rollouts that were added to a campaign database since the last call."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .readonly import snapshot

Floats = NDArray[np.float64]

_ADDED = """
    SELECT seq, problem, variant, test, replicate, replicates, robustness, robustness_of FROM rollouts
    WHERE seq > ? AND robustness IS NOT NULL ORDER BY seq
"""


class AddedValues(NamedTuple):
    """The robustness of the rollouts of one variant that were recorded at once, clipped, with test and replicate."""

    problem: str
    variant: str
    tests: NDArray[np.int64]
    replicates: NDArray[np.int64]
    robustness: Floats


class RolloutValueReader:
    """Reads the robustness of the rollouts of a campaign in increments; used by one thread at a time."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._seq = 0

    def read(self) -> list[AddedValues]:
        """Return what was added, in the order of the database; rollouts without a robustness are left out.

        Raises:
            JournalError: there is no campaign, or its database is damaged.
            OSError: the disk is full or fails.

        """
        with snapshot(self._directory) as connection:
            rows = connection.execute(_ADDED, [self._seq]).fetchall()
            found = [AddedValues(problem, variant, *_each(*row)) for _, problem, variant, *row in rows]
        self._seq = max((row[0] for row in rows), default=self._seq)
        return found


def _each(
    test: int, replicate: int, replicates: int, least: float, column: bytes | None
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return test, replicate and robustness of each rollout of a row; NaN is that of a rollout that failed."""
    values = np.array([least]) if column is None else np.frombuffer(column)
    kept = np.flatnonzero(~np.isnan(values))
    return test + kept // replicates, replicate + kept % replicates, values[kept]

"""The time grids of rollouts: one that no other rollout has is doubted before it becomes a fact.

A result is recorded at once only if its grid is known: two workers have sent it, one has repeated it, or it was
recorded. Stamps that one attempt alone gives would move the borders of windows, and of a pair, which needs one grid,
nobody could tell which of the two is at fault. A system with steps of its own for every start is recognised by its
grids that repetitions confirm.
"""

import hashlib

import numpy as np

from ...schemas.ids import RolloutId
from ...schemas.trajectory.trajectory import Trajectory

MOST = 1000
"""Grids that are kept, the latest: a system with steps of its own for every start has as many as starts."""

VARIOUS = 3
"""Grids that repetitions have confirmed, after which a grid of its own is how this system is."""


class Grids:
    """The grids of one session by their digests, each with who sent it first, for which rollout; None once it is known.

    A worker that sends it again for the same rollout has repeated it.
    """

    def __init__(self) -> None:
        self._senders: dict[str, tuple[str, RolloutId] | None] = {}
        self._confirmed = 0

    @property
    def vary(self) -> bool:
        """Whether the system has grids of its own for its starts, so that an unknown one is no sign of a fault."""
        return self._confirmed >= VARIOUS

    def is_known(self, trajectory: Trajectory, worker: str, rollout: RolloutId) -> bool:
        """Whether the grid of a worker's result is known; afterwards that worker has sent it."""
        grid, new = _digest(trajectory), ("", rollout)
        first = self._senders.pop(grid, new)
        # Two workers, or one that repeats it: a worker alone may be wrong in the same way for every rollout.
        known = first is None or (first is not new and (first[0] != worker or first[1] == rollout))
        self._senders[grid] = (
            None if known else (worker, rollout)
        )  # the last one: the oldest is the first to be forgotten
        if len(self._senders) > MOST:
            del self._senders[next(iter(self._senders))]
        return known

    def take(self, trajectory: Trajectory) -> None:
        """Know the grid of a result that was doubted and is recorded: its repetition gave the same."""
        self._confirmed += 1
        self._senders[_digest(trajectory)] = None


def _digest(trajectory: Trajectory) -> str:
    return hashlib.sha256(np.ascontiguousarray(trajectory.samples[:, 0]).tobytes()).hexdigest()

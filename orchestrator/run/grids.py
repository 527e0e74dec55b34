"""The time grids of rollouts that are compared in pairs.

A rollout with another grid than its partner has no objective, and which of the two is at fault shows in neither alone.
So the first one of a pair is recorded at once only if its grid is known: two workers have sent it, or it was recorded.
"""

import hashlib

import numpy as np

from ...schemas.trajectory import Trajectory

MOST = 1000
"""Grids that are kept, the latest: a system with steps of its own for every start has as many as starts."""


class Grids:
    """The grids of one session by their digests, each with the worker that sent it first; None once it is known."""

    def __init__(self) -> None:
        self._senders: dict[str, str | None] = {}

    def is_known(self, trajectory: Trajectory, worker: str) -> bool:
        """Whether the grid of a worker's result is known; afterwards that worker has sent it."""
        grid = _digest(trajectory)
        known = self._senders.pop(grid, worker) != worker
        self._senders[grid] = None if known else worker  # the last one: the oldest is the first to be forgotten
        if len(self._senders) > MOST:
            del self._senders[next(iter(self._senders))]
        return known

    def take(self, trajectory: Trajectory) -> None:
        """Know the grid of a rollout that is recorded."""
        self._senders[_digest(trajectory)] = None


def _digest(trajectory: Trajectory) -> str:
    return hashlib.sha256(np.ascontiguousarray(trajectory.samples[:, 0]).tobytes()).hexdigest()

"""Recorded rollouts, read back from the run directory."""

from pathlib import Path

from ...schemas.ids import RolloutId
from ...schemas.result.facts import RolloutFact
from ...schemas.trajectory.trajectory import Trajectory, decode
from ..store import files as evidence
from .ports import FactStore


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

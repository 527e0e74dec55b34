"""Recorded rollouts, read back from the run directory."""

from pathlib import Path

from ...schemas.facts import RolloutFact
from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory, decode
from ..store import files as evidence
from .ports import FactStore


class Recorded:
    """Starts and trajectories of recorded rollouts; every method reads from the disk.

    Raises:
        EvidenceError: a file is missing or damaged.

    """

    def __init__(self, directory: Path, store: FactStore) -> None:
        self._directory, self._store = directory, store

    def start(self, rollout: RolloutId) -> tuple[float, ...]:
        """Return the start of a rollout."""
        return self._store.proposal(rollout.problem, rollout.test).proposal.x

    def trajectory(self, rollout: RolloutId) -> Trajectory:
        """Return the trajectory of a rollout."""
        return self.read(self._store.rollout(rollout))

    def read(self, fact: RolloutFact) -> Trajectory:
        """Return the trajectory that a fact names."""
        return decode(evidence.read_evidence(self._directory, fact.path, fact.sha256))

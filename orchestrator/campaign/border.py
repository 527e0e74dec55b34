"""The border of a ledger: every check before a rollout becomes a fact, so that no fact stops the campaign."""

from ...schemas.errors import EvidenceError, PerfboundError, UnusableTrajectoryError
from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory
from .admission import admit
from .ledger import Ledger
from .objectives import measured
from .observation import Others


class Admission:
    """The admission of results to a ledger: nothing becomes a fact from which the campaign could not continue."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self.columns = tuple(column.name for column in ledger.header.spec.columns)

    def admit(self, rollout: RolloutId, payload: bytes, sha256: str) -> Trajectory:
        """Return the trajectory of a result for an open or a damaged rollout.

        Raises:
            EvidenceError: as `admit`.
            UnusableTrajectoryError: as `admit`, or the objective cannot be computed from it.
            PerfboundError: the file of another rollout of its test is missing or damaged.

        """
        trajectory = admit(self._ledger.request(rollout), self.columns, payload, sha256)
        self.check(rollout, trajectory)
        return trajectory

    def check(self, rollout: RolloutId, trajectory: Trajectory) -> None:
        """Refuse a trajectory from which the objective cannot be computed; see `admit`."""
        if self._ledger.restores(rollout):
            return  # its digest decides: it was recorded, and perhaps observed
        fault = objective_fault(self._ledger, rollout, trajectory, lambda key: self._others(rollout, key))
        if fault is not None:
            raise UnusableTrajectoryError(f"the objective cannot be computed: {fault}")

    def _others(self, rollout: RolloutId, key: tuple[str, int]) -> list[Trajectory]:
        facts = self._ledger.series[rollout.problem].rollouts.get(rollout.test, ())
        try:
            return [self._ledger.recorded.kept(fact) for fact in facts if fact.rollout[2:] == key]
        except EvidenceError as fault:
            # No failure of this attempt: what is damaged was recorded before it.
            raise PerfboundError(str(fault)) from None


def objective_fault(ledger: Ledger, rollout: RolloutId, trajectory: Trajectory, others: Others) -> str | None:
    """Return why an open test with this rollout could not be observed; None if it could.

    `others` are the trajectories of its test with which it is compared.
    """
    try:
        robustness = ledger.observer.robustness(trajectory)
        if robustness is not None:
            measured(robustness, "the robustness")
        ledger.deciders[rollout.problem].check(ledger.series[rollout.problem], rollout, trajectory, others)
    except ValueError as fault:
        return str(fault)
    return None

"""The border of a ledger: every check before a rollout becomes a fact, so that no fact stops the campaign."""

from ...schemas.errors import EvidenceError, PerfboundError, UnusableTrajectoryError
from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory
from .ledger import Ledger
from .objectives import measured
from .observation import Others


class Admission:
    """The admission of results to a ledger: nothing becomes a fact from which the campaign could not continue."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self.columns = tuple(column.name for column in ledger.header.spec.columns)

    def check(self, rollout: RolloutId, trajectory: Trajectory) -> bool:
        """Refuse a trajectory from which the objective cannot be computed; see `admit`.

        Return whether it is the first of a pair, so that its time grid has been compared with no other one.
        """
        if self._ledger.restores(rollout):
            return False  # its digest decides: it was recorded, and perhaps observed
        unpaired = False

        def others(key: tuple[str, int]) -> list[Trajectory]:
            nonlocal unpaired
            found = self._others(rollout, key)
            unpaired |= not found
            return found

        fault = objective_fault(self._ledger, rollout, trajectory, others)
        if fault is not None:
            raise UnusableTrajectoryError(f"the objective cannot be computed: {fault}")
        return unpaired

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

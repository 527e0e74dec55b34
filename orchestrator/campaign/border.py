"""The border of a ledger: every check before a rollout becomes a fact, so that no fact stops the campaign."""

from typing import Literal

from ...schemas.errors import EvidenceError, PerfboundError, UnusableTrajectoryError
from ...schemas.ids import RolloutId
from ...schemas.trajectory.trajectory import Trajectory
from .ledger import Ledger
from .objectives import measured
from .observation import Others

Compared = Literal["alone", "first of a pair", "same"]
"""The time grid of a result: of a rollout without partner, of one whose partner comes, or that of a recorded one."""


class Admission:
    """The admission of results to a ledger: nothing becomes a fact from which the campaign could not continue."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self.columns = tuple(column.name for column in ledger.header.spec.columns)

    def check(self, rollout: RolloutId, trajectory: Trajectory) -> Compared:
        """Refuse a trajectory from which the objective cannot be computed; see `admit`.

        Return with how much its time grid has been compared.
        """
        if self._ledger.restores(rollout):
            return "same"  # its digest decides: it was recorded, and perhaps observed
        compared: Compared = "alone"

        def others(key: tuple[str, int]) -> list[Trajectory]:
            nonlocal compared
            found = self._others(rollout, key)
            if compared != "first of a pair":
                compared = "same" if found else "first of a pair"
            return found

        fault = objective_fault(self._ledger, rollout, trajectory, others)
        if fault is not None:
            raise UnusableTrajectoryError(f"the objective cannot be computed: {fault}")
        return compared

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
            # A fact from which the mathematics cannot continue would stop the campaign at every resume.
            measured(robustness, "the robustness")
        ledger.deciders[rollout.problem].check(ledger.series[rollout.problem], rollout, trajectory, others)
    except ValueError as fault:
        return str(fault)
    return None

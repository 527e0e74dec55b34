"""One test's trajectories become its y: the value of the maximised objective J."""

from collections.abc import Callable, Mapping

from orchestrator import objectives
from orchestrator.stl.formula import Formula, parse
from schemas.campaign import CampaignConfig, Problem
from schemas.system import SystemSpec
from schemas.trajectory import Trajectory

Trajectories = Mapping[tuple[str, int], Trajectory]
"""(variant, replicate) -> trajectory of one test."""


class Observer:
    """The objectives of a campaign.

    Raises:
        FormulaError: the specification is not a formula over the columns of the system.

    """

    def __init__(self, config: CampaignConfig, spec: SystemSpec) -> None:
        self._config = config
        self._columns = tuple(column.name for column in spec.columns)
        self._formula: Formula | None = None
        if config.specification is not None:
            self._formula = parse(config.specification, self._columns)
        self._objectives: dict[str, Callable[[Problem, Trajectories], float]] = {
            "nominal_robustness": self._nominal_robustness,
            "sim_gap": self._sim_gap,
            "true_risk": self._true_risk,
            "maximum": self._maximum,
        }

    def robustness(self, trajectory: Trajectory) -> float | None:
        """Return the clipped robustness; None for a campaign without specification."""
        if self._formula is None or self._config.clip is None:
            return None
        return objectives.clipped_robustness(self._formula, trajectory.columns, trajectory.samples, self._config.clip)

    def observe(self, problem: Problem, trajectories: Trajectories) -> float:
        """Return y of a test, in the unit of the objective; J = -rho for a minimum."""
        return self._objectives[problem.name](problem, trajectories)

    def _nominal_robustness(self, _problem: Problem, trajectories: Trajectories) -> float:
        return -objectives.mean(self._all(trajectories))

    def _true_risk(self, _problem: Problem, trajectories: Trajectories) -> float:
        return -objectives.risk(self._all(trajectories), self._config.risk_weight)

    def _sim_gap(self, problem: Problem, trajectories: Trajectories) -> float:
        gap = self._config.gap_of(problem)
        assert gap is not None, "the campaign file was checked"
        column = self._columns.index(gap.column)
        pairs = [
            (trajectories["true", replicate].samples, trajectories["nominal", replicate].samples)
            for replicate in range(self._config.replicates_of(problem))
        ]
        return objectives.mean([objectives.signal_sup(column, true, nominal) for true, nominal in pairs])

    def _maximum(self, problem: Problem, trajectories: Trajectories) -> float:
        assert problem.column is not None, "the campaign file was checked"
        column = self._columns.index(problem.column)
        values = [objectives.column_maximum(column, trajectory.samples) for trajectory in trajectories.values()]
        return objectives.mean(values)

    def _all(self, trajectories: Trajectories) -> list[float]:
        values = [self.robustness(trajectory) for trajectory in trajectories.values()]
        return [value for value in values if value is not None]

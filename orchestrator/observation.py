"""One test's trajectories become its observation: the value y of the maximised objective J, and its parts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from orchestrator import objectives
from orchestrator.bounds.risk import linearised
from orchestrator.stl.formula import Formula, parse
from orchestrator.stl.predicates import predicate_sup
from schemas.campaign import CampaignConfig, Problem
from schemas.system import SystemSpec
from schemas.trajectory import Trajectory

Trajectories = Mapping[tuple[str, int], Trajectory]
"""(variant, replicate) -> trajectory of one test."""


@dataclass(frozen=True, slots=True)
class Observation:
    """y of a test, and what each replicate contributed to it, in the order of the replicates.

    `each` holds values of J whose mean is y; for a risk (`true_risk` without linearisation) it holds the robustness.
    """

    y: float
    each: tuple[float, ...]


def shared(spec: SystemSpec, problem: Problem, variant: str) -> bool:
    """Whether the replicates of a test share one rollout of this variant, because it does not depend on the seed."""
    return problem.name == "sim_gap" and problem.method == "rigorous" and variant not in spec.noisy


class Observer:
    """The objectives of a campaign.

    Raises:
        FormulaError: the specification is not a formula over the columns of the system.

    """

    def __init__(self, config: CampaignConfig, spec: SystemSpec) -> None:
        self._config, self._spec = config, spec
        self._columns = tuple(column.name for column in spec.columns)
        self._formula: Formula | None = None
        if config.specification is not None:
            self._formula = parse(config.specification, self._columns)
        self._known: WeakKeyDictionary[Trajectory, float] = WeakKeyDictionary()
        self._objectives: dict[str, Callable[[Problem, Trajectories], Observation]] = {
            "nominal_robustness": self._nominal_robustness,
            "sim_gap": self._sim_gap,
            "true_risk": self._true_risk,
            "maximum": self._maximum,
        }

    def robustness(self, trajectory: Trajectory) -> float | None:
        """Return the clipped robustness; None for a campaign without specification.

        Raises:
            ValueError: the formula cannot be evaluated on this trajectory.

        """
        if self._formula is None or self._config.clip is None:
            return None
        found = self._known.get(trajectory)  # asked for when it is recorded, and when its test is observed
        if found is None:
            formula, clip = self._formula, self._config.clip
            found = objectives.clipped_robustness(formula, trajectory.columns, trajectory.samples, clip)
            self._known[trajectory] = found
        return found

    def observe(self, problem: Problem, trajectories: Trajectories) -> Observation:
        """Return the observation of a test, in the unit of the objective; J = -rho for a minimum.

        Raises:
            ValueError: a value is not finite, or two trajectories have different time grids.

        """
        return self._objectives[problem.name](problem, trajectories)

    def _nominal_robustness(self, _problem: Problem, trajectories: Trajectories) -> Observation:
        return _mean([-value for value in self._all(trajectories)])

    def _true_risk(self, problem: Problem, trajectories: Trajectories) -> Observation:
        values, weight = self._all(trajectories), self._config.risk_weight
        if problem.method == "paper":
            return Observation(-objectives.risk(values, weight), tuple(values))
        if problem.linearised is not None and problem.method == "rigorous":
            constants = problem.linearised
            return _mean([-linearised(value, weight, constants.centre, constants.spread) for value in values])
        return Observation(-objectives.mean(values), tuple(values))

    def _sim_gap(self, problem: Problem, trajectories: Trajectories) -> Observation:
        gaps = []
        for replicate in range(self._config.replicates_of(problem)):
            nominal = trajectories["nominal", 0 if shared(self._spec, problem, "nominal") else replicate]
            true = trajectories["true", 0 if shared(self._spec, problem, "true") else replicate]
            gaps.append(self._gap(problem, nominal, true))
        return _mean(gaps)

    def _gap(self, problem: Problem, nominal: Trajectory, true: Trajectory) -> float:
        gap, clip = self._config.gap_of(problem), self._config.clip
        assert gap is not None, "the campaign file was checked"
        assert clip is not None, "the campaign file was checked"
        if gap.kind == "robustness":
            first, second = self._all({("nominal", 0): nominal, ("true", 0): true})
            return first - second
        if gap.kind == "predicate_sup":
            assert self._formula is not None, "the campaign file was checked"
            found = predicate_sup(self._formula, nominal.columns, true.samples, nominal.samples)
        else:
            assert gap.column is not None, "the campaign file was checked"
            found = objectives.signal_sup(self._columns.index(gap.column), true.samples, nominal.samples)
        # The paper does not clip. A sup gap above (M + m)/L says no more about the clipped robustness than that.
        return found if problem.method == "paper" else min(found, (clip[1] - clip[0]) / gap.lipschitz)

    def _maximum(self, problem: Problem, trajectories: Trajectories) -> Observation:
        assert problem.column is not None, "the campaign file was checked"
        column = self._columns.index(problem.column)
        return _mean([objectives.column_maximum(column, trajectory.samples) for trajectory in trajectories.values()])

    def _all(self, trajectories: Trajectories) -> list[float]:
        values = [self.robustness(trajectory) for trajectory in trajectories.values()]
        return [value for value in values if value is not None]


def _mean(each: list[float]) -> Observation:
    return Observation(objectives.mean(each), tuple(each))

"""What a rollout shows of a specification: its robustness, what it violates, and when."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....schemas.file.requirements import conjunction
from ....schemas.system import SystemSpec
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Beyond
from ...campaign.objectives import scored
from ...mathematics.search.goal import goal_of
from ...mathematics.stl.over_time import robustness_signal, worst_moment
from ...mathematics.stl.parser import Formula, parse_formula
from ...mathematics.stl.text import text

SAME_MOMENT = 0.1
"""Of the horizon: a failure that is further away in time is another one."""
Specification = str | Mapping[str, str]
"""A formula, or the formula of each requirement by its name."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a rollout shows."""

    robustness: float
    """Not clipped."""
    violated: tuple[str, ...]
    """Names of requirements, or parts of the formula; empty where it is met."""
    moment: float | None
    """When it is first violated, in s; of a formula that is not about every moment, when its robustness is attained.

    None where that is no single stretch of time.
    """

    @property
    def fails(self) -> bool:
        """Whether the specification is violated."""
        return self.robustness < 0.0


class Judge:
    """The outcomes of rollouts of one system.

    Raises:
        FormulaError: the specification is not one over the columns of the system.

    """

    def __init__(self, specification: Specification, spec: SystemSpec, beyond: Beyond) -> None:
        self._after_end, self._beyond = spec.after_end, beyond
        if isinstance(specification, str):
            self._whole = parse_formula(specification, spec.units)
            self._parts = {text(part): part for part in goal_of(self._whole)[1]}
        else:
            self._whole = parse_formula(conjunction(specification.values()), spec.units)
            self._parts = {name: parse_formula(formula, spec.units) for name, formula in specification.items()}

    def outcome(self, trajectory: Trajectory) -> Outcome:
        """Return what a rollout shows.

        Raises:
            ValueError: the formula cannot be evaluated on this trajectory.

        """
        robustness = self._robustness(self._whole, trajectory)
        if not robustness < 0.0:
            return Outcome(robustness, (), None)
        violated = tuple(name for name, part in self._parts.items() if self._of_part(part, trajectory) < 0.0)
        return Outcome(robustness, violated, self._moment(violated, trajectory))

    def _moment(self, violated: Sequence[str], trajectory: Trajectory) -> float | None:
        t, samples = trajectory.samples[:, 0], trajectory.samples
        firsts = list[float]()
        for part in (self._parts[name] for name in violated):
            signal = robustness_signal(part, trajectory.columns, samples, self._beyond)
            below = np.flatnonzero(signal.values < 0.0)
            if signal.attained == "least" and below.size:
                firsts.append(float(t[below[0]]))
        if firsts:
            return min(firsts)
        found = worst_moment(self._whole, trajectory.columns, samples, self._beyond)
        return None if found is None else float(t[found.first])

    def _of_part(self, part: Formula, trajectory: Trajectory) -> float:
        try:
            return self._robustness(part, trajectory)
        except ValueError:  # what decides nothing alone, as a window that is empty
            return 0.0

    def _robustness(self, formula: Formula, trajectory: Trajectory) -> float:
        return scored(formula, trajectory, self._after_end, self._beyond).robustness


def same_moment(one: Outcome, other: Outcome, horizon: float, share: float = SAME_MOMENT) -> bool:
    """Whether two failures are within a share of the horizon; one without a moment is like none that has one."""
    moments = [math.inf if each.moment is None else each.moment for each in (one, other)]
    return moments[0] == moments[1] or abs(moments[1] - moments[0]) <= share * horizon


def at(moment: float | None) -> str:
    """Return a moment in s as the end of a phrase; empty for None."""
    return "" if moment is None else f", violated at {moment:.4g} s"

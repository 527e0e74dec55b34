"""What a calibrated campaign may be expected to prove, with which budget: a row for each method."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from ....schemas.file.config import CampaignConfig
from ....schemas.file.method_spaces import LATTICE_PARAMETERS
from ....schemas.file.objectives import OBJECTIVES, MethodName
from ....schemas.file.problem_models import KrigingProblem
from ....schemas.system import SystemSpec
from ....schemas.values import Guess
from ...campaign import plan as plans
from .budget import budget_forecast, expected_bound
from .constants import CONSTANTS, Constant, ProblemCalibration
from .tolerance import ToleranceForecast, tolerance_forecast


class Forecast(Protocol):
    """The forecast of one problem, if every assumption holds; it is no claim."""

    @property
    def bound(self) -> Guess:
        """The bound of J at the end of the budget."""
        ...

    @property
    def fitted(self) -> float:
        """The largest J of the fitted function, which no bound of J may be expected to fall below."""
        ...

    @property
    def error(self) -> float:
        """Standard error of this."""
        ...

    @property
    def rollouts(self) -> int:
        """Rollouts of the proposed budget, with the closing checks."""
        ...

    @property
    def seconds(self) -> float:
        """Their duration."""
        ...

    @property
    def numbers(self) -> dict[str, Any]:
        """The forecast as JSON."""
        ...

    def remedy(self, limit: float) -> str:
        """Return what would bring the bound of J nearer to a limit."""
        ...

    def settled(self, constants: tuple[Constant, ...]) -> tuple[Constant, ...]:
        """Return the constants of the problem with its budget."""
        ...


FORECASTS: Mapping[MethodName, Callable[..., Forecast]] = {
    "rigorous": tolerance_forecast,
    "kriging": budget_forecast,
}
"""A row for each method that is calibrated."""

# Whether method `kriging` may be expected to prove more than the default


@dataclass(frozen=True, slots=True)
class Instead:
    """Two methods with the same rollouts, bounds of J."""

    problem: str
    rollouts: int
    """Of the budget, without closing checks."""
    default: float
    kriging: Guess
    sign: int
    """1 where J is the objective, -1 where it is minus the objective."""

    @property
    def is_tighter(self) -> bool:
        """Whether even the worse end of the range of `kriging` is better."""
        return self.kriging.high < self.default


def kriging_instead(
    config: CampaignConfig,
    spec: SystemSpec,
    found: ProblemCalibration,
    guess: ToleranceForecast,
    given: Mapping[str, Any],
) -> Instead | None:
    """Return the comparison; None where `kriging` does not fit, or nothing is noisy.

    `config` has the constants of the default, `guess` is its forecast, and `given` are the keys of the draft.
    """
    measured, trial = found.measured, found.choice.chosen
    problem = next(each for each in config.problems if each.name == found.name)
    fits = "kriging" in OBJECTIVES[problem.name].methods and len(measured.box.names) <= LATTICE_PARAMETERS
    if not fits or not measured.noisy or config.where is not None or config.clip is None or trial is None:
        return None
    keys = {each.key: each.value for each in CONSTANTS["kriging"](measured, found.choice, trial, given)}
    keys |= {key: each for key, each in found.keys.items() if key == "linearised"}
    if "linearised" in given:
        keys["linearised"] = given["linearised"]
    kept = problem.model_dump(include={"name", "delta", "gap"}, exclude_none=True)
    instead = KrigingProblem.model_validate({**kept, "method": "kriging", **keys})
    plan = plans.plan(config.model_copy(update={"problems": (instead,)}), spec, instead)
    rollouts = guess.budget * config.replicates_of(problem)
    bound = expected_bound(config, plan, trial.fit, measured, rollouts)
    sign = -1 if config.sense_of(problem) == "min" else 1
    return Instead(found.name, rollouts, guess.bound.middle, bound, sign)

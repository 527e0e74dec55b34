"""What a calibrated campaign may be expected to prove, with which budget: a row for each method."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ...schemas.file.objectives import MethodName
from .calibration import Constant
from .calibration_budget import budget_forecast
from .calibration_tolerance import tolerance_forecast


class Forecast(Protocol):
    """The forecast of one problem, if every assumption holds; it is no claim."""

    @property
    def bound(self) -> float:
        """The bound of J at the end of the budget."""
        ...

    @property
    def fitted(self) -> float:
        """The largest J of the fitted function."""
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

    def settled(self, constants: tuple[Constant, ...]) -> tuple[Constant, ...]:
        """Return the constants of the problem with its budget."""
        ...


FORECASTS: Mapping[MethodName, Callable[..., Forecast]] = {
    "rigorous": tolerance_forecast,
    "kriging": budget_forecast,
}
"""A row for each method that is calibrated."""

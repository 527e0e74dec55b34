"""The interface of a system under test, and the check of its arguments."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import SimulationError
from ...schemas.system import Option, OptionValue, SystemSpec, Variant
from ...schemas.system_check import Acts
from ...schemas.trajectory.input_signal import InputSignal
from ...schemas.trajectory.trajectory import Trajectory, Visual

Floats = NDArray[np.float64]
Seeds = NDArray[np.uint64]
Progress = Callable[[int], None]
"""Called with the number of control steps done so far; it may raise `Cancelled`."""


class Cancelled(Exception):  # noqa: N818  (not an error: the orchestrator has withdrawn the rollout)
    """The rollout was cancelled while it ran."""


class SystemUnderTest(Protocol):
    """A simulator of one closed-loop system; constructed once per process without arguments, used for many rollouts.

    The constructor must be cheap and import no simulator: `spec` is read before anything is created.
    Equal arguments give bitwise equal trajectories, whatever ran before in the same process.
    Derive from this class to inherit what is optional.
    """

    files: Sequence[str] = ()
    """Files, folders and patterns that the rollouts read, relative to the file of the class; optional."""

    @property
    def spec(self) -> SystemSpec:
        """The specification of the system: its parameters, columns and options."""
        ...

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> Trajectory:
        """Simulate `horizon` seconds from the starting condition `x` (one value per parameter of the spec).

        A value is a number; of a parameter with `signal` it is an `InputSignal`, a function of time that may have
        knots.

        The first sample is at 0; the last one at the horizon, or before it by less than a step and by at most a
        fiftieth of the horizon. A trajectory that is shorter is refused.

        A system whose spec has disturbances also takes `disturbances`, the value of each by its name.

        Raises:
            SimulationError: `x` or the resulting trajectory is not finite, or an argument is outside the spec.
            Cancelled: raised by `progress`.

        """
        ...

    def visual(self, trajectory: Trajectory) -> Visual | None:  # noqa: ARG002  (a default of the port)
        """Return the visual part of a trajectory of this system, one pose per entry of `trajectory.frames`.

        Optional: None, the default, draws nothing.
        """
        return None

    def acted(self) -> Acts | None:
        """Return what a policy did in the last rollout, for `check-system`; None, the default, without one."""
        return None


def acts_of(system: object) -> Acts | None:
    """Return what a policy did in the last rollout of a system, which may be one of others and know nothing of that."""
    acted = getattr(system, "acted", None)
    return None if acted is None else cast(Acts | None, acted())


class Vectorised(SystemUnderTest, Protocol):
    """A system whose spec says `vectorised`: it simulates many rollouts in one call."""

    def rollouts(
        self,
        starts: Floats,
        *,
        variant: Variant,
        seeds: Seeds,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> object:
        """Simulate a rollout from each row of `starts` (R, p), with its seed of `seeds` (R,), in one call.

        Return an array (R, T, n), the columns in the order of the spec and the time first, which is the same for all.
        Each rollout is the one that `rollout` gives, bit by bit, but for a system whose spec says `batch_is_the_unit`.
        One whose numbers are not finite fails alone, and in the latter with its batch. Of a system with disturbances
        the value of each is an array (R,).

        Raises:
            SimulationError: the batch cannot be simulated.
            Cancelled: raised by `progress`.

        """
        ...


def checked_options(
    spec: SystemSpec, x: Sequence[Any], *, variant: Variant, horizon: float, options: Mapping[str, OptionValue]
) -> dict[str, OptionValue]:
    """Return the options with their defaults filled in, after a check of every argument of a rollout.

    Called before the simulator: a rollout that starts with a NaN can spoil the ones after it.

    Raises:
        SimulationError: an argument is not finite or outside the spec.

    """
    if variant not in spec.variants:
        raise SimulationError(f"{spec.name} has no variant {variant!r}, only {', '.join(spec.variants)}")
    if not 0 <= horizon <= spec.max_horizon:
        raise SimulationError(f"the horizon of {spec.name} is 0 to {spec.max_horizon} s, not {horizon}")
    if len(x) != len(spec.parameters):
        raise SimulationError(f"{spec.name} takes {len(spec.parameters)} parameters, not {len(x)}")
    for parameter, value in zip(spec.parameters, x, strict=True):
        if parameter.signal != isinstance(value, InputSignal):
            wanted = "an input over time" if parameter.signal else "a number"
            raise SimulationError(f"{parameter.name} is {wanted}, not {type(value).__name__}")
        for number in value.ends if isinstance(value, InputSignal) else (value,):
            if not (math.isfinite(number) and parameter.low <= number <= parameter.high):
                raise SimulationError(f"{parameter.name} = {number} is outside [{parameter.low}, {parameter.high}]")
    known = {option.name: option for option in spec.options}
    if unknown := sorted(set(options) - set(known)):
        raise SimulationError(f"{spec.name} has no option {unknown[0]!r}, only {', '.join(known)}")
    return {name: _checked_option(option, options.get(name, option.default)) for name, option in known.items()}


def disturbances_of(spec: SystemSpec, values: Sequence[Any] | Floats) -> dict[str, Any]:
    """Return the disturbances of a request as the keyword argument of a rollout: none for a system without any.

    Raises:
        SimulationError: there are not as many as the system declares.

    """
    names = [each.name for each in spec.disturbances]
    if len(values) != len(names):
        raise SimulationError(f"{spec.name} has {len(names)} disturbances, not {len(values)}")
    return {"disturbances": dict(zip(names, values, strict=True))} if names else {}


def checked_disturbances(spec: SystemSpec, given: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return the disturbances of a rollout, if they are those of the spec.

    Raises:
        SimulationError: one is missing or unknown, or a value is not finite.

    """
    names = [each.name for each in spec.disturbances]
    if sorted(given or ()) != sorted(names):
        wanted = ", ".join(names) or "none"
        raise SimulationError(f"{spec.name} takes the disturbances {wanted}, not {', '.join(given or ()) or 'none'}")
    for name, value in (given or {}).items():
        if not np.isfinite(value).all():
            raise SimulationError(f"{name} = {value} is not a finite number")
    return given or {}


def checked_starts(spec: SystemSpec, starts: Floats) -> None:
    """Refuse starts (R, p) of which one is not finite or outside the spec; raises as `checked_options`."""
    low, high = (np.array([getattr(each, end) for each in spec.parameters]) for end in ("low", "high"))
    if starts.ndim != 2 or starts.shape[1] != len(low):
        raise SimulationError(f"{spec.name} takes {len(low)} parameters, not starts of shape {starts.shape}")
    outside = ~((starts >= low) & (starts <= high))  # in this way also for a NaN
    if outside.any():
        row, k = np.argwhere(outside)[0]
        each = spec.parameters[k]
        raise SimulationError(f"{each.name} = {starts[row, k]} is outside [{each.low}, {each.high}]")


def _checked_option(option: Option, value: OptionValue) -> OptionValue:
    if option.choices:
        if value not in option.choices:
            raise SimulationError(f"{option.name} is one of {', '.join(option.choices)}, not {value!r}")
        return value
    low = -math.inf if option.low is None else option.low
    high = math.inf if option.high is None else option.high
    if isinstance(value, str) or not (math.isfinite(value) and low <= value <= high):
        raise SimulationError(f"{option.name} is a number in [{low}, {high}], not {value!r}")
    return float(value)

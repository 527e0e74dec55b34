"""A Python function, or a class whose instances are called, as a system under test; see `decorator`."""

import functools
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import SimulationError, shortened
from ...schemas.real_numbers import real_array
from ...schemas.system import OptionValue, SystemSpec, Variant
from ...schemas.trajectory.trajectory import Trajectory, Visual
from .base import Progress, SystemUnderTest, checked_disturbances, checked_options
from .life import signs_of_life
from .place import Worker

Floats = NDArray[np.float64]


def passed(vectorised: bool) -> tuple[str, ...]:
    """Return the arguments of a rollout, or of a batch, that a function gets if it names them."""
    return ("seeds" if vectorised else "seed", "horizon", "variant", "progress", "worker")


class FunctionSystem(SystemUnderTest):
    """A decorated function; calling it calls the function itself."""

    def __init__(
        self,
        function: Callable[..., Any],
        spec: SystemSpec,
        step: float | None,
        keywords: Sequence[inspect.Parameter],
        files: Sequence[str] = (),
    ) -> None:
        functools.update_wrapper(self, function)
        self._function, self._spec, self._step = function, spec, step
        taken = {*passed(spec.vectorised), *(each.name for each in spec.disturbances)}
        self._passed = tuple(each.name for each in keywords if each.name in taken)
        self._instance: Callable[..., Any] | None = None if inspect.isclass(function) else function
        self.files = files
        self._whole = {each.name for each in keywords if isinstance(each.default, int)}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the function."""
        return self._function(*args, **kwargs)

    @property
    def spec(self) -> SystemSpec:
        """The specification that follows from the signature and the decorator."""
        return self._spec

    @property
    def step(self) -> float | None:
        """Seconds between two samples; None where the function returns the time."""
        return self._step

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """Call the function at `x`, and make a trajectory of what it returns.

        Raises:
            SimulationError: an argument is outside the spec, or the function returns something else than its columns.
            Cancelled: raised by `progress`.

        """
        chosen = checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        drawn = checked_disturbances(self._spec, disturbances)
        given = {"seed": seed, "horizon": horizon, "variant": variant, **drawn}
        returned = self._called(x, given, chosen, progress)
        return as_trajectory(returned, self._spec.own_columns, self._step)

    def _called(
        self, x: Sequence[Any], given: Mapping[str, Any], chosen: Mapping[str, OptionValue], progress: Progress
    ) -> object:
        """Call the function with what it names of `given`, and with the options."""
        given = {**given, "progress": progress}
        if "worker" in self._passed:
            given["worker"] = Worker.own()
        keywords: dict[str, Any] = {name: given[name] for name in self._passed}
        keywords |= {name: self._option(name, value) for name, value in chosen.items()}
        if self._instance is None:  # a class: made once, for what is costly between rollouts
            self._instance = self._function()
        with nullcontext() if "progress" in self._passed else signs_of_life(progress):
            return self._instance(*x, **keywords)

    def visual(self, trajectory: Trajectory) -> Visual:  # noqa: ARG002  (the same for all)
        """Return a plot of every column: a function has no scene."""
        return Visual(plots=True)

    def _option(self, name: str, value: OptionValue) -> OptionValue | int:
        if name not in self._whole or isinstance(value, str):
            return value
        if value != int(value):
            raise SimulationError(f"option {name} is a whole number, not {value!r}")
        return int(value)


def as_trajectory(returned: object, columns: tuple[str, ...], step: float | None) -> Trajectory:
    """Return what a function returned as a trajectory; `columns` begin with `t`, which may be missing.

    Raises:
        SimulationError: it does not have these columns, their lengths differ, or its time is not known.

    """
    if isinstance(returned, Trajectory):
        return returned
    if returned is None:
        raise SimulationError(f"the function returned None; end it with `return {listed_names(columns[1:])}`")
    samples = as_samples(returned, columns, step)
    try:
        return Trajectory(columns, samples)
    except ValueError as error:
        raise SimulationError(str(error)) from None


def as_samples(returned: object, columns: tuple[str, ...], step: float | None) -> Floats:
    """Return what a function returned as one array (T, n), in the order of `columns`. Raises as `as_trajectory`."""
    found = _by_name(returned, columns[1:])
    lengths = {name: len(values) for name, values in found.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        raise SimulationError(
            f"the columns differ in length: {listed} samples; return one value of each for every sample"
        )
    count = next(iter(lengths.values()))
    if "t" not in found:
        if step is None and count != 1:
            raise SimulationError(
                f"{count} samples without time; return a dict with a column 't', or give `step` to the decorator"
            )
        found["t"] = np.arange(count, dtype=np.float64) * float(step or 0.0)
    return np.column_stack([found[name] for name in columns])


def _by_name(returned: object, names: tuple[str, ...]) -> dict[str, Floats]:
    """Return the columns by their names, and `t` if it was returned."""
    if isinstance(returned, Mapping):
        if set(returned) - {"t"} != set(names) - {"t"}:
            raise SimulationError(
                f"the function returned {listed_names(returned)}, its columns are {listed_names(names)}"
            )
        return {name: _samples_of(returned[name], name, 1) for name in returned}
    if isinstance(returned, tuple | list):
        if len(returned) != len(names):
            rows = all(isinstance(each, tuple | list) and len(each) == len(names) for each in returned)
            remedy = "return one array for each, not a row for each sample" if rows else "return one array for each"
            raise SimulationError(
                f"the function returned {len(returned)} values, its columns are {listed_names(names)}; {remedy}"
            )
        return {name: _samples_of(value, name, 1) for name, value in zip(names, returned, strict=True)}
    array = _samples_of(returned, "the returned value", 2, width=len(names))
    if array.shape[1] != len(names):
        remedy = "return its transpose" if array.shape[0] == len(names) else f"return (samples, {len(names)})"
        words = array_words(returned) or array_words(array)
        raise SimulationError(f"the function returned {words}, its columns are {listed_names(names)}; {remedy}")
    return {name: array[:, k] for k, name in enumerate(names)}


def real_values(value: object, name: str) -> Floats:
    """Return what a function returned as `name` as real numbers; raises SimulationError with shape and dtype."""
    try:
        return real_array(value)
    except ValueError as error:
        words = array_words(value)
        raise SimulationError(f"{name}{f', {words},' if words else ''} {error}") from None


def array_words(value: object) -> str:
    """Return shape and dtype of an array in words; empty for everything else."""
    return f"an array {value.shape} of {value.dtype}" if isinstance(value, np.ndarray) else ""


def _samples_of(value: object, name: str, dimensions: int, *, width: int = 1) -> Floats:
    array = real_values(value, name)
    if array.ndim == 0:
        array = array.reshape((1,) * dimensions)
    elif array.ndim == 1 and dimensions == 2:
        array = array.reshape(-1, 1) if width == 1 else array.reshape(1, -1)  # one column, or one sample
    if array.ndim != dimensions or not len(array):
        raise SimulationError(f"{name} has the shape {array.shape}; return at least one sample, one number for each")
    return array


def listed_names(names: Collection[object]) -> str:
    """Return names as a list in words."""
    return shortened(", ".join(map(str, names))) or "none"

"""A Python function, or a class whose instances are called, as a system under test.

The specification follows from the signature: positional arguments are the parameters of the starting condition, keyword
arguments with defaults are the options. `seed`, `horizon`, `variant`, `progress` and `worker` are passed to a function
that names them: one without `seed` is deterministic, one without `variant` has a single one.
"""

import functools
import inspect
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from importlib.metadata import version
from typing import Any, Literal, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import DefinitionError, SimulationError, shortened
from ...schemas.file.space import SystemChoice
from ...schemas.ranges import SEED_BITS
from ...schemas.real_numbers import real_array
from ...schemas.system import AfterEnd, Option, OptionValue, Parameter, SystemSpec, Variant, timed_columns
from ...schemas.trajectory.trajectory import Trajectory, Visual
from ...schemas.values import Stamps
from .base import Progress, SystemUnderTest, checked_options
from .life import signs_of_life
from .place import Worker

NAME = re.compile(r"[a-z][a-z0-9_]*")
PASSED = ("seed", "horizon", "variant", "progress", "worker")
"""Arguments of a rollout that a function gets if it names them."""
RESERVED = tuple(SystemChoice.model_fields)
"""Keys of `[system]` that are no options."""
SINGLE: tuple[Variant, ...] = ("nominal",)
BOTH: tuple[Variant, ...] = ("nominal", "true")

Floats = NDArray[np.float64]


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
        self._passed = tuple(each.name for each in keywords if each.name in PASSED)
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
    ) -> Trajectory:
        """Call the function at `x`, and make a trajectory of what it returns.

        Raises:
            SimulationError: an argument is outside the spec, or the function returns something else than its columns.
            Cancelled: raised by `progress`.

        """
        chosen = checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        given: dict[str, Any] = {"seed": seed, "horizon": horizon, "variant": variant, "progress": progress}
        if "worker" in self._passed:
            given["worker"] = Worker.own()
        keywords: dict[str, Any] = {name: given[name] for name in self._passed}
        keywords |= {name: self._option(name, value) for name, value in chosen.items()}
        if self._instance is None:  # a class: made once, for what is costly between rollouts
            self._instance = self._function()
        with nullcontext() if "progress" in self._passed else signs_of_life(progress):
            returned = self._instance(*x, **keywords)
        return as_trajectory(returned, self._spec.own_columns, self._step)

    def visual(self, trajectory: Trajectory) -> Visual:  # noqa: ARG002  (the same for all)
        """Return a plot of every column: a function has no scene."""
        return Visual(plots=True)

    def _option(self, name: str, value: OptionValue) -> OptionValue | int:
        if name not in self._whole or isinstance(value, str):
            return value
        if value != int(value):
            raise SimulationError(f"option {name} is a whole number, not {value!r}")
        return int(value)


def system(
    *,
    parameters: Mapping[str, Parameter],
    columns: Mapping[str, str],
    step: float | None = None,
    noisy: Collection[Variant] | None = None,
    name: str | None = None,
    max_horizon: float = 3600.0,
    versions: Mapping[str, str] | None = None,
    seed_bits: int = SEED_BITS,
    trajectory_bytes: int | None = None,
    files: Sequence[str] = (),
    stamps: Stamps = "exact",
    after_end: AfterEnd | None = None,
) -> Callable[[Callable[..., Any]], FunctionSystem]:
    """Make a system under test of a function, or of a class with `__call__`.

    `parameters` has the range and the unit of every positional argument, `columns` the units of what is returned; with
    `step`, in seconds, the time of a sample follows from its number, else it is the column `t`. `noisy` names the
    variants that depend on the seed, by default all of a function that takes one. Seeds are below 2^`seed_bits`, which
    is 31 to 53: 32 for Gymnasium and for libraries in C. The name is that of the function. A file of more than
    ten times `trajectory_bytes` is a failed rollout. `files` are those that a rollout reads, such as an FMU or weights:
    files, folders and patterns, relative to the file of the function; a changed one is another system. `stamps` says of
    what kind the returned times are. With `after_end` a rollout may end before the horizon: "hold" holds its last
    state, "fail" counts it as a violation besides; trajectories then have a last column, `ended`.

    The function returns one array (T,) for each column, one array (T, n), or a dict of arrays; a number for each column
    is one sample at time 0.

    Raises:
        DefinitionError: signature and arguments do not fit each other.

    >>> import perfbound as pb
    >>> @pb.system(parameters={"x": pb.Parameter(0, 1, unit="m")}, columns={"y": "m"})
    ... def square(x, *, gain=2.0):
    ...     return gain * x * x
    >>> square.spec.options[0].name, square.spec.noisy, square(0.5)
    ('gain', (), 0.5)

    """

    def decorate(function: Callable[..., Any]) -> FunctionSystem:
        place = f"system {getattr(function, '__name__', function)!r}"
        if not isinstance(columns, Mapping):
            raise DefinitionError(f"{place}: columns are names with units, such as {{'height': 'm'}}; '' for none")
        signature = _signature(function, place)
        positional = [each.name for each in signature if each.kind is not each.KEYWORD_ONLY]
        if positional != list(parameters):
            raise DefinitionError(
                f"{place}: its positional arguments are {_joined_names(positional)}, "
                f"`parameters` has {_joined_names(parameters)}; "
                "give both the same names in the same order, and put everything else behind a `*`"
            )
        keywords = [each for each in signature if each.kind is each.KEYWORD_ONLY]
        passed = [each.name for each in keywords if each.name in PASSED]
        options = tuple(_option_of(each, place) for each in keywords if each.name not in PASSED)
        variants = BOTH if "variant" in passed else SINGLE
        found = noisy if noisy is not None else (variants if "seed" in passed else ())
        if unknown := set(found) - set(variants):
            raise DefinitionError(
                f"{place}: noisy: it has no variant {sorted(unknown)[0]!r}, only {', '.join(variants)}"
            )
        if found and "seed" not in passed:
            raise DefinitionError(f"{place}: noisy: a function that depends on chance takes its `seed` as an argument")
        for each, given in parameters.items():
            if not isinstance(given, Parameter):
                raise DefinitionError(f"{place}: {each}: {given!r} is no parameter; write pb.Parameter(low, high)")
        for each in (*positional, *columns, *(option.name for option in options)):
            if not NAME.fullmatch(each):
                raise DefinitionError(f"{place}: {each!r}: a name consists of a-z, 0-9 and _, the first is a letter")
        if step is not None and not step > 0:
            raise DefinitionError(f"{place}: step: {step!r} is not a positive number of seconds")
        try:
            spec = SystemSpec(
                name=(name or str(getattr(function, "__name__", "system"))).lower().strip("_").replace("_", "-"),
                doc=(inspect.getdoc(function) or "").partition("\n")[0],
                parameters=tuple(each.model_copy(update={"name": key}) for key, each in parameters.items()),
                columns=timed_columns(columns, after_end),
                options=options,
                variants=variants,
                noisy=tuple(each for each in variants if each in found),
                max_horizon=max_horizon,
                timed="horizon" in passed,
                default_horizon=_default_horizon(keywords, max_horizon),
                versions=_interpolating(parameters) | dict(versions or {}),
                seed_bits=seed_bits,
                trajectory_bytes=trajectory_bytes,
                stamps=stamps,
                after_end=after_end,
            )
        except DefinitionError as error:
            raise DefinitionError(f"{place}: {error}") from None
        return FunctionSystem(function, spec, step, keywords, files)

    return decorate


def as_trajectory(returned: object, columns: tuple[str, ...], step: float | None) -> Trajectory:
    """Return what a function returned as a trajectory; `columns` begin with `t`, which may be missing.

    Raises:
        SimulationError: it does not have these columns, their lengths differ, or its time is not known.

    """
    if isinstance(returned, Trajectory):
        return returned
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
                f"the function returned {_joined_names(returned)}, its columns are {_joined_names(names)}"
            )
        return {name: _samples_of(returned[name], name, 1) for name in returned}
    if isinstance(returned, tuple | list):
        if len(returned) != len(names):
            raise SimulationError(
                f"the function returned {len(returned)} values, its columns are {_joined_names(names)}"
            )
        return {name: _samples_of(value, name, 1) for name, value in zip(names, returned, strict=True)}
    array = _samples_of(returned, "the returned value", 2, width=len(names))
    if array.shape[1] != len(names):
        raise SimulationError(f"the function returned an array {array.shape}, its columns are {_joined_names(names)}")
    return {name: array[:, k] for k, name in enumerate(names)}


def _samples_of(value: object, name: str, dimensions: int, *, width: int = 1) -> Floats:
    try:
        array = real_array(value)
    except ValueError as error:
        raise SimulationError(f"{name} {error}") from None
    if array.ndim == 0:
        array = array.reshape((1,) * dimensions)
    elif array.ndim == 1 and dimensions == 2:
        array = array.reshape(-1, 1) if width == 1 else array.reshape(1, -1)  # one column, or one sample
    if array.ndim != dimensions or not len(array):
        raise SimulationError(f"{name} has the shape {array.shape}; return at least one sample, one number for each")
    return array


def _signature(function: Callable[..., Any], place: str) -> list[inspect.Parameter]:
    called = function.__call__ if inspect.isclass(function) else function
    signature = list(inspect.signature(called).parameters.values())[1 if inspect.isclass(function) else 0 :]
    for each in signature:
        if each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
            raise DefinitionError(f"{place}: {each} has no names; list the arguments")
    return signature


def _option_of(argument: inspect.Parameter, place: str) -> Option:
    default = argument.default
    if argument.name in RESERVED:
        raise DefinitionError(f"{place}: option {argument.name!r} is a key of [system] itself; choose another name")
    if default is argument.empty:
        raise DefinitionError(
            f"{place}: option {argument.name!r} needs a default; perfbound passes {', '.join(PASSED)}"
        )
    if isinstance(default, str):
        choices = get_args(argument.annotation) if get_origin(argument.annotation) is Literal else (default,)
        return Option(name=argument.name, default=default, choices=tuple(map(str, choices)))
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise DefinitionError(f"{place}: option {argument.name!r} is a number or a word, not {default!r}")
    return Option(name=argument.name, default=float(default))


def _interpolating(parameters: Mapping[str, Parameter]) -> dict[str, str]:
    """Return the versions of the packages that interpolate input signals, and so decide the trajectory."""
    found = any(each.signal for each in parameters.values())
    return {package: version(package) for package in ("numpy", "scipy") if found}


def _default_horizon(keywords: Sequence[inspect.Parameter], max_horizon: float) -> float | None:
    """Return the default of `horizon` in s: None if it has none, 0 for a function that takes no horizon."""
    found = [each.default for each in keywords if each.name == "horizon"]
    if not found:
        return 0.0
    (default,) = found
    if default is inspect.Parameter.empty:
        return None
    if isinstance(default, bool) or not isinstance(default, int | float) or not 0 < default <= max_horizon:
        raise DefinitionError(f"horizon: {default!r} is not a number of seconds in (0, {max_horizon:g}]")
    return float(default)


def _joined_names(names: Collection[object]) -> str:
    return shortened(", ".join(map(str, names))) or "none"

"""The decorator that makes a system under test of a Python function.

The specification follows from the signature: positional arguments are the parameters of the starting condition, keyword
arguments with defaults are the options. `seed`, `horizon`, `variant`, `progress` and `worker` are passed to a function
that names them: one without `seed` is deterministic, one without `variant` has a single one. A vectorised function
names `seeds` in place of `seed`.
"""

import inspect
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib.metadata import version
from typing import Any, Literal, get_args, get_origin

from ...schemas.errors import DefinitionError
from ...schemas.file.disturbance import Disturbance
from ...schemas.file.space import SystemChoice
from ...schemas.ranges import SEED_BITS
from ...schemas.system import AfterEnd, Option, Parameter, SystemSpec, Variant, timed_columns
from ...schemas.values import Stamps
from .function import FunctionSystem, listed_names, passed
from .vectorised import VectorisedSystem

NAME = re.compile(r"[a-z][a-z0-9_]*")
RESERVED = tuple(SystemChoice.model_fields)
"""Keys of `[system]` that are no options."""
SINGLE: tuple[Variant, ...] = ("nominal",)
BOTH: tuple[Variant, ...] = ("nominal", "true")


def system(
    *,
    parameters: Mapping[str, Parameter],
    columns: Mapping[str, str],
    disturbances: Mapping[str, Disturbance] | None = None,
    residual: bool | None = None,
    reported: Mapping[str, Disturbance] | None = None,
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
    vectorised: bool = False,
    batch_is_the_unit: bool = False,
) -> Callable[[Callable[..., Any]], FunctionSystem]:
    """Make a system under test of a function, or of a class with `__call__`.

    `parameters` has the range and the unit of every positional argument, `columns` the units of what is returned; with
    `step`, in seconds, the time of a sample follows from its number, else it is the column `t`. `noisy` names the
    variants that depend on chance, by default all of a function that takes a seed or has disturbances. Seeds are below
    2^`seed_bits`, which is 31 to 53: 32 for Gymnasium and for libraries in C. The name is that of the function. A file
    of more than ten times `trajectory_bytes` is a failed rollout. `files` are those that a rollout reads, such as an
    FMU or weights: files, folders and patterns, relative to the file of the function; a changed one is another system.
    `stamps` says of what kind the returned times are. With `after_end` a rollout may end before the horizon: "hold"
    holds its last state, "fail" counts it as a violation besides; trajectories then have a last column, `ended`.

    `disturbances` are named random numbers with their laws, such as `{"gust": Normal(0, 2, unit="m/s")}`: keyword-only
    arguments of the function, which the campaign draws. `residual` says whether anything else is random, by default
    where the function also takes a seed. `reported` are those that the function draws from its seed: each has the name
    of a column, whose first sample is its value. They explain what rollouts do as the others do, if they have their
    laws; the campaign tests that.

    The function returns one array (T,) for each column, one array (T, n), or a dict of arrays; a number for each column
    is one sample at time 0.

    A `vectorised` function simulates R rollouts in one call: it gets each parameter as an array (R,) and `seeds` as an
    array (R,), and returns one array (R, T, n), one array (R, T) for each column, or a dict of such arrays. With
    `batch_is_the_unit` its last digits may depend on the size of the batch and on the place in it.

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
                f"{place}: its positional arguments are {listed_names(positional)}, "
                f"`parameters` has {listed_names(parameters)}; "
                "give both the same names in the same order, and put everything else behind a `*`"
            )
        keywords = [each for each in signature if each.kind is each.KEYWORD_ONLY]
        laws = _laws_of(disturbances or {}, keywords, place)
        own = _known_laws(reported or {}, "reported", place)
        taken, seed = (*passed(vectorised), *laws), "seeds" if vectorised else "seed"
        named = [each.name for each in keywords if each.name in taken]
        options = tuple(_option_of(each, place, taken) for each in keywords if each.name not in taken)
        variants = BOTH if "variant" in named else SINGLE
        found = noisy if noisy is not None else (variants if seed in named or laws else ())
        if unknown := set(found) - set(variants):
            raise DefinitionError(
                f"{place}: noisy: it has no variant {sorted(unknown)[0]!r}, only {', '.join(variants)}"
            )
        if found and seed not in named and not laws:
            raise DefinitionError(
                f"{place}: noisy: a function that depends on chance takes its `{seed}` as an argument"
            )
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
                timed="horizon" in named,
                default_horizon=_default_horizon(keywords, max_horizon),
                versions=_interpolating(parameters) | dict(versions or {}),
                seed_bits=seed_bits,
                trajectory_bytes=trajectory_bytes,
                stamps=stamps,
                disturbances=tuple(each.named(key, each.unit) for key, each in laws.items()),
                residual=not laws or (seed in named if residual is None else residual),
                reported=tuple(each.named(key, columns.get(key, each.unit)) for key, each in own.items()),
                after_end=after_end,
                vectorised=vectorised,
                batch_is_the_unit=batch_is_the_unit,
            )
        except DefinitionError as error:
            raise DefinitionError(f"{place}: {error}") from None
        return (VectorisedSystem if vectorised else FunctionSystem)(function, spec, step, keywords, files)

    return decorate


def _laws_of(
    given: Mapping[str, Disturbance], keywords: Sequence[inspect.Parameter], place: str
) -> Mapping[str, Disturbance]:
    """Return the disturbances, if they are keyword-only arguments of the function without defaults."""
    named = {each.name: each for each in keywords}
    for name in _known_laws(given, "disturbances", place):
        if name not in named or named[name].default is not inspect.Parameter.empty:
            raise DefinitionError(
                f"{place}: disturbances: the function takes no argument {name}; name it behind the *, without default"
            )
    return given


def _known_laws(given: Mapping[str, Disturbance], key: str, place: str) -> Mapping[str, Disturbance]:
    """Return laws by their names, if they are such."""
    for name, law in given.items():
        if not isinstance(law, Disturbance):
            raise DefinitionError(f"{place}: {key}: {name}: {law!r} is no law; write pb.Normal(0, 1)")
        if not NAME.fullmatch(name):
            raise DefinitionError(f"{place}: {key}: {name!r}: a name consists of a-z, 0-9 and _, the first is a letter")
    return given


def _signature(function: Callable[..., Any], place: str) -> list[inspect.Parameter]:
    called = function.__call__ if inspect.isclass(function) else function
    signature = list(inspect.signature(called).parameters.values())[1 if inspect.isclass(function) else 0 :]
    for each in signature:
        if each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
            raise DefinitionError(f"{place}: {each} has no names; list the arguments")
    return signature


def _option_of(argument: inspect.Parameter, place: str, taken: Sequence[str]) -> Option:
    default = argument.default
    if argument.name in RESERVED:
        raise DefinitionError(f"{place}: option {argument.name!r} is a key of [system] itself; choose another name")
    if default is argument.empty:
        raise DefinitionError(f"{place}: option {argument.name!r} needs a default; perfbound passes {', '.join(taken)}")
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

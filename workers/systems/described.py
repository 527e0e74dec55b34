"""The parts of a specification that every system takes from its campaign file."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ...schemas.errors import DefinitionError, SimulationError, meant
from ...schemas.file.config import CampaignConfig
from ...schemas.instants import SAMPLES
from ...schemas.system import Option, OptionValue, Parameter, SystemSpec
from ...schemas.trajectory.trajectory import Trajectory, Visual
from ..faults import NOT_OF_SYSTEMS, fault_text
from .base import SystemUnderTest

LIBRARIES = frozenset({"fmpy", "gymnasium"})
MOST_NAMED = 30
"""Names in a message."""


class DescribedSystem(SystemUnderTest):
    """A system that a campaign file describes: its specification is made once, and it is drawn as its columns."""

    def __init__(self, spec: SystemSpec) -> None:
        self._spec = spec

    @property
    def spec(self) -> SystemSpec:
        """The specification that follows from the campaign file and from what it names."""
        return self._spec

    def visual(self, trajectory: Trajectory) -> Visual:  # noqa: ARG002  (the same for all)
        """Return a plot of every column."""
        return Visual(plots=True)


def listed(names: Sequence[str]) -> str:
    """Return the first of many names in words.

    >>> listed(["a", "b"]), listed([])
    ('a, b', 'none')
    """
    return ", ".join([*names[:MOST_NAMED], *(["..."] if len(names) > MOST_NAMED else [])]) or "none"


def space_parameters(config: CampaignConfig, where: str = "") -> Iterator[Parameter]:
    """Yield the parameters of `[space]`; those of a list of starts are x1, x2, ..., each with its range.

    Raises:
        DefinitionError: a name is none here; `where` is the file.

    """
    if not isinstance(config.space, dict):
        for k, values in enumerate(zip(*config.space.rows, strict=True)):
            yield Parameter(name=f"x{k + 1}", low=min(values), high=max(values))
        return
    for name, box in config.space.items():
        if not re.fullmatch("[a-z][a-z0-9_]*", name):
            raise DefinitionError(f"{where}: space: names are in lower case here; write {own_name(name)} for {name!r}")
        yield Parameter(name=name, unit=box.unit, low=box.low, high=box.high, signal=box.signal is not None)


def of_campaign(name: str) -> str:
    """Return a hint for a key of the campaign that stands below `[system]`; nothing for another one."""
    return (
        f"put the key `{name}` of the campaign above the first [table]; " if name in CampaignConfig.model_fields else ""
    )


def option_of(name: str, value: OptionValue) -> Option:
    """Return the option of a system for one that the file sets; a word has no other value."""
    return Option(name=name, default=value, choices=(value,) if isinstance(value, str) else ())


def name_of(path: str, otherwise: str) -> str:
    """Return the name of a system from that of its file; one without a letter in front begins with another word.

    >>> name_of("./Pendulum_2.sh", "program"), name_of("7.sh", "program")
    ('pendulum-2', 'program-7')
    """
    found = re.sub("[^a-z0-9]+", "-", Path(path).stem.lower()).strip("-")
    return found if re.match("[a-z]", found) else f"{otherwise}-{found}".strip("-")


def own_name(name: str) -> str:
    """Return the name here of a variable of others.

    >>> own_name("tank[1].Level"), own_name("der(h)")
    ('tank_1_level', 'der_h')
    """
    return re.sub("[^a-z0-9]+", "_", name.lower()).strip("_")


def steps_within(horizon: float, step: float, name: str) -> int:
    """Return the steps of a horizon; a last one that a rounding has cut off is one.

    Raises:
        SimulationError: there is none.

    >>> steps_within(0.3, 0.1, "pole")
    3

    """
    steps = int(horizon / step * (1.0 + 1e-12) + 1e-9)
    if not steps:
        raise SimulationError(f"a horizon of {horizon:g} s is less than a step of {name}, {step:g} s")
    return steps


def check_horizon(horizon: float | None, step: float, where: str) -> None:
    """Refuse a horizon that samples at the multiples of `step` do not cover; of 0, no step, nothing is known.

    >>> check_horizon(10.0, 0.3, "c.toml")
    >>> check_horizon(10.0, 3.0, "c.toml")
    Traceback (most recent call last):
    ...
    perfbound.schemas.errors.DefinitionError: c.toml: horizon: of steps of 3 s the last one before 10 s ends at 9 s; \
give horizon = 9, or another step

    """
    if horizon is None or not step:
        return
    if horizon < step * (1.0 - 1e-9):
        raise DefinitionError(
            f"{where}: horizon: {horizon:g} s is less than one step of the system, {step:g} s; give the s that a "
            "rollout lasts"
        )
    last = steps_within(horizon, step, where) * step
    if horizon - last > horizon / SAMPLES * (1.0 + 1e-9):
        raise DefinitionError(
            f"{where}: horizon: of steps of {step:g} s the last one before {horizon:g} s ends at {last:g} s; give "
            f"horizon = {last:g}, or another step"
        )


def check_file(path: Path, place: str) -> None:
    """Refuse what is no file, with the nearest one of its kind beside it."""
    if path.is_file():
        return
    if path.is_dir():
        raise DefinitionError(f"{place}: is a folder; name the file in it")
    near = meant(path.name, [each.name for each in path.parent.glob(f"*{path.suffix}")])
    raise DefinitionError(f"{place}: there is no such file in {path.parent}{near and '; ' + near.strip()}")


@contextmanager
def placed(place: str) -> Iterator[None]:
    """Put a place in front of an error of a definition."""
    try:
        yield
    except DefinitionError as error:
        raise DefinitionError(f"{place}: {error}") from None


@contextmanager
def blaming(place: str, simulated: str | None = None) -> Iterator[None]:
    """Turn what the code of others raises into an error at a place; what we say of a rollout has another one."""
    try:
        yield
    except (DefinitionError, *NOT_OF_SYSTEMS):
        raise
    except SimulationError as error:
        raise DefinitionError(f"{simulated or place}: {error}") from None
    except BaseException as error:  # noqa: BLE001  (any: untrusted code)
        raise DefinitionError(f"{place}: {own_words(error)}") from None


def own_words(error: BaseException) -> str:
    """Return what an exception says; of a library that we call without a place there, which helps nobody."""
    library = type(error).__module__.partition(".")[0] in LIBRARIES or type(error) is Exception
    return str(error).rstrip(".") if library and str(error) else fault_text(error)


def fixed_option(name: str, value: OptionValue) -> Option:
    """Return an option that has the value of the file alone: the environment is made with it, once."""
    ends = {} if isinstance(value, str) else {"low": value, "high": value}
    return option_of(name, value).model_copy(update=ends)


def check_whole(names: Iterable[str], config: CampaignConfig, where: str, owner: str) -> None:
    """Refuse a range of numbers for an integer: each of them would stand for the nearest one."""
    for name in names:
        box = config.space[name] if isinstance(config.space, dict) else None
        if box is None or all(each is not None and float(each).is_integer() for each in (box.low, box.step)):
            continue
        if box.choices is None or not all(each.is_integer() for each in box.choices):
            raise DefinitionError(
                f"{where}: space: {name} is an integer of the {owner}; write {name} = {{ low = {box.low:.0f}, "
                f"high = {box.high:.0f}, step = 1 }}, or its `choices`"
            )

"""The systems under test of this worker: those that are installed, and the files that its command line names."""

import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

from ...schemas.errors import DefinitionError, PerfboundError, UnknownSystemError
from ...schemas.system import SystemSpec
from ..faults import NOT_OF_SYSTEMS, fault_text
from .base import SystemUnderTest
from .declared import DeclaredFiles, WithSpec, declared_files
from .elsewhere import digests_of, modules_elsewhere
from .fingerprint import code_of_files, files_of_module, versions_of
from .pair import TwoSimulators
from .rig import DescribedRig

GROUP = "perfbound.systems"


_FROM_FILES: dict[str, SystemUnderTest] = {}


def add_file(reference: str) -> str:
    """Load a system from a file, `FILE.py:NAME` or a campaign file, and return its name.

    Raises:
        DefinitionError: it cannot be loaded, or an installed system has its name.
        CampaignError: the campaign file cannot be read.

    """
    from .files import load_reference  # noqa: PLC0415  (most workers have none)

    system = load_reference(reference)
    # Of two simulators one may be missing here, and with it what they are together.
    name = system.name if isinstance(system, TwoSimulators) else system.spec.name
    if name in _entry_points():
        raise DefinitionError(f"{reference}: an installed system is called {name!r}; give the function another name")
    _FROM_FILES[name] = system
    return name


def add(system: SystemUnderTest) -> None:
    """Add a system that only this process has, in place of one of its name."""
    _FROM_FILES[system.spec.name] = system


def rigs() -> list[DescribedRig]:
    """Return the rigs among the systems in files: nothing here makes their rollouts."""
    return [each for each in _FROM_FILES.values() if isinstance(each, DescribedRig)]


def available() -> tuple[str, ...]:
    """Return the names of the systems, sorted, without importing an installed one."""
    return tuple(sorted({*_entry_points(), *_FROM_FILES}))


def load_system(name: str) -> SystemUnderTest:
    """Return the system `name`; one process has one instance of each.

    Raises:
        UnknownSystemError: it is not installed.
        DefinitionError: the system of this entry point has another name.

    """
    return _FROM_FILES[name] if name in _FROM_FILES else _of_entry_point(name)


def usable() -> dict[str, SystemSpec | str]:
    """Return the spec of every available system, or in its place the reason why it cannot be used here."""
    return {name: _spec_or_reason(name) for name in available()}


def announced() -> dict[str, SystemSpec]:
    """Return the specs of all usable systems; of two simulators also that of each, as `NAME/VARIANT`."""
    pairs = {name: system for name, system in _FROM_FILES.items() if isinstance(system, TwoSimulators)}
    halves = {f"{name}/{variant}": spec for name, each in pairs.items() for variant, spec in each.present.items()}
    return {name: each for name, each in usable().items() if isinstance(each, SystemSpec)} | halves


def _spec_or_reason(name: str) -> SystemSpec | str:
    try:
        return load_system(name).spec
    except PerfboundError as error:
        return str(error)
    except NOT_OF_SYSTEMS:
        raise
    except BaseException as error:  # noqa: BLE001  (any: a broken plug-in must not hide the others)
        return f"{name}: it cannot be loaded: {fault_text(error)}; install its package again"


@cache
def _of_entry_point(name: str) -> SystemUnderTest:
    found = _entry_points()
    if name not in found:
        known = ", ".join(available())
        raise UnknownSystemError(
            f"the system {name!r} is not installed here; known: {known}; one in a file needs --system FILE.py:NAME"
        )
    loaded = found[name].load()
    system = cast(SystemUnderTest, loaded() if isinstance(loaded, type) else loaded)
    if system.spec.name != name:  # a request names the system, and would not find it
        raise DefinitionError(f"the entry point {name!r} leads to {system.spec.name!r}; give both the same name")
    files, above = files_of_module(found[name].module)
    place = getattr(sys.modules[type(system).__module__], "__file__", None)
    try:
        declared = DeclaredFiles(declared_files(system.files, Path(place or above).parent, above))
    except DefinitionError as error:
        raise DefinitionError(f"{name}: {error}") from None
    sources = [each for each in files if each.suffix == ".py"]
    versions = versions_of(sources) | system.spec.versions
    elsewhere = (each for each in modules_elsewhere(sources).values() if each.place not in files)
    code = code_of_files(files, above) | digests_of(elsewhere)
    return WithSpec(system, declared, code=code | declared.digests, versions=versions)


def module_of(name: str) -> str | None:
    """Return the module of an installed system; None for one that is not installed."""
    found = _entry_points().get(name)
    return None if found is None else found.module


def _entry_points() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}

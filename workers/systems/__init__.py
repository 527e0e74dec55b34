"""The systems under test of this worker: those that are installed, and the files that its command line names."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import cast

from ...schemas.errors import DefinitionError, UnknownSystemError
from .base import SystemUnderTest

GROUP = "perfbound.systems"


_FROM_FILES: dict[str, SystemUnderTest] = {}


def add_file(reference: str) -> str:
    """Load a system from a file, `FILE.py:NAME`, and return its name.

    Raises:
        DefinitionError: it cannot be loaded, or an installed system has its name.

    """
    from .files import load_file  # noqa: PLC0415  (most workers have none)

    system = load_file(reference)
    name = system.spec.name
    if name in _entry_points():
        raise DefinitionError(f"{reference}: an installed system is called {name!r}; give the function another name")
    _FROM_FILES[name] = system
    return name


def available() -> tuple[str, ...]:
    """Return the names of the systems, sorted, without importing an installed one."""
    return tuple(sorted({*_entry_points(), *_FROM_FILES}))


def load_system(name: str) -> SystemUnderTest:
    """Return the system `name`; one process has one instance of each.

    Raises:
        UnknownSystemError: it is not installed.

    """
    return _FROM_FILES[name] if name in _FROM_FILES else _of_entry_point(name)


@cache
def _of_entry_point(name: str) -> SystemUnderTest:
    found = _entry_points()
    if name not in found:
        known = ", ".join(available())
        raise UnknownSystemError(
            f"the system {name!r} is not installed here; known: {known}; one in a file needs --system FILE.py:NAME"
        )
    loaded = found[name].load()
    return cast(SystemUnderTest, loaded() if isinstance(loaded, type) else loaded)


def _entry_points() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}

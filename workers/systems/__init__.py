"""The systems under test that this worker has installed, found by their entry points."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import cast

from ...schemas.errors import UnknownSystemError
from .base import SystemUnderTest

GROUP = "perfbound.systems"


def available() -> tuple[str, ...]:
    """Return the names of the installed systems, sorted, without importing any of them."""
    return tuple(sorted(_entry_points()))


@cache
def load_system(name: str) -> SystemUnderTest:
    """Return the system `name`; one process has one instance of each.

    Raises:
        UnknownSystemError: it is not installed.

    """
    found = _entry_points()
    if name not in found:
        raise UnknownSystemError(f"the system {name!r} is not installed here; known: {', '.join(available())}")
    return cast(SystemUnderTest, found[name].load()())


def _entry_points() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}

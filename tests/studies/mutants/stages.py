"""Which tests a mutant meets, from those of its folder to all of `make test`; the first failure ends it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from tests.architecture.source import FLOORS

UNIT = PurePosixPath("tests/unit")
ROOMS = ("schemas", *(room for floor in reversed(FLOORS) for room in floor), "workers", "library")
"""Folders of the unit tests, those of the imported before those of the importing."""
LAST = 3


@dataclass(frozen=True)
class Stage:
    """A run of pytest."""

    number: int
    paths: tuple[str, ...]
    without: str | None
    """Folder of an earlier stage."""
    usual: tuple[str, ...]
    """Paths of the run without a mutant which shows how long this one may take."""

    def arguments(self) -> list[str]:
        """Return what pytest gets."""
        return [*self.paths, *([] if self.without is None else [f"--ignore={self.without}"])]


def stages(path: str, tree: Path) -> list[Stage]:
    """Return the stages of a module: the unit tests of its folder, all unit tests, the rest."""
    rooms = sorted(each.name for each in (tree / UNIT).iterdir() if each.is_dir() and each.name != "__pycache__")
    home = str(_home(PurePosixPath(path), lambda each: (tree / each).is_dir()))
    first = [] if home == str(UNIT) else [Stage(1, (home,), None, (home,))]
    others = tuple(each for room in _nearest_first(path, rooms) if (each := f"{UNIT}/{room}") != home)
    second = Stage(2, others, home if first else None, (str(UNIT),))
    return [*first, second, Stage(LAST, ("tests",), str(UNIT), ("tests", f"--ignore={UNIT}"))]


def _home(path: PurePosixPath, exists: Callable[[PurePosixPath], bool]) -> PurePosixPath:
    """Return the folder of unit tests that mirrors that of a module, or the nearest one above it that exists."""
    parts = path.parent.parts
    wanted = UNIT.joinpath(*(parts[1:] if parts[0] in {"orchestrator", "perfbound"} else parts))
    while not exists(wanted):
        wanted = wanted.parent
    return wanted


def _nearest_first(path: str, rooms: Sequence[str]) -> Iterator[str]:
    """Yield all folders of unit tests: the room of the module, the rooms that may import it, and the others."""
    own = next(part for part in PurePosixPath(path).parts if part not in {"orchestrator", "perfbound"})
    at = ROOMS.index(own) if own in ROOMS else 0
    order = [*ROOMS[at:], *ROOMS[:at]]
    yield from sorted(rooms, key=lambda room: order.index(room) if room in order else len(order))

"""Which tests a mutant meets, from those of its folder to all of `make test`; the first failure ends it."""

import re
from dataclasses import dataclass
from functools import cache
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
    arguments: tuple[str, ...]
    """What pytest gets: files, in the order of their tests."""
    usual: tuple[str, ...]
    """What it gets for the run without a mutant which shows how long this one may take."""


def stages(path: str, tree: Path) -> list[Stage]:
    """Return the stages of a module: the unit tests of its folder, all other unit tests, the rest.

    In a stage those files come first that import the module, then those of its room, then those of the rooms above.
    """
    home, module = _home(PurePosixPath(path), tree), PurePosixPath(path).stem
    imports = re.compile(rf"^ *from .*\.{module} import |^ *from .* import .*\b{module}\b", re.MULTILINE)
    order = _order(path)

    def rank(file: PurePosixPath) -> tuple[bool, int, str]:
        room = file.relative_to(UNIT).parts[0]
        return not imports.search(_text(tree / file)), order.index(room) if room in order else len(order), str(file)

    files = sorted((PurePosixPath(each.relative_to(tree)) for each in (tree / UNIT).rglob("test_*.py")), key=rank)
    near = tuple(str(each) for each in files if home != UNIT and each.is_relative_to(home))
    others = tuple(str(each) for each in files if str(each) not in near)
    rest = ("tests", f"--ignore={UNIT}")
    return [*([Stage(1, near, (str(home),))] if near else []), Stage(2, others, (str(UNIT),)), Stage(LAST, rest, rest)]


def _home(path: PurePosixPath, tree: Path) -> PurePosixPath:
    """Return the folder of unit tests that mirrors that of a module, or the nearest one above it that exists."""
    parts = path.parent.parts
    wanted = UNIT.joinpath(*(parts[1:] if parts[0] in {"orchestrator", "perfbound"} else parts))
    while not (tree / wanted).is_dir():
        wanted = wanted.parent
    return wanted


def _order(path: str) -> list[str]:
    """Return the rooms, with that of the module first and those that may import it next."""
    room = next(part for part in PurePosixPath(path).parts if part not in {"orchestrator", "perfbound"})
    at = ROOMS.index(room) if room in ROOMS else 0
    return [*ROOMS[at:], *ROOMS[:at]]


@cache
def _text(file: Path) -> str:
    return file.read_text()

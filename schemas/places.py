"""The place of an error in the code of a user, from the frames that lead to it."""

import os
import sysconfig
from collections.abc import Sequence
from pathlib import Path

Frame = tuple[str, int]
"""File and line."""
PERFBOUND = Path(__file__).parents[1]
PACKAGES = frozenset({"site-packages", "dist-packages"})
COMMAND_LINE = "click"
"""The package that calls perfbound, and is above it in a whole stack."""


def own_place(frames: Sequence[Frame]) -> str:
    """Return file and line of `own_frame` as text; empty if there is none.

    >>> own_place([("/home/me/cars.py", 7), ("/env/lib/python3.11/site-packages/numpy/linalg.py", 9)])
    '/home/me/cars.py, line 7'
    """
    found = own_frame(frames)
    return f"{short_path(found[0])}, line {found[1]}" if found else ""


def own_frame(frames: Sequence[Frame]) -> Frame | None:
    """Return the innermost frame, the last one, in code of the user.

    Frames of perfbound and of Python are never named. Those of installed packages are only where there are no others:
    of the package that perfbound called, if the system is installed itself, and not of a library below it.

    >>> packages = "/env/lib/python3.11/site-packages"
    >>> own_frame([(f"{packages}/robot/arm.py", 7), (f"{packages}/numpy/linalg.py", 9)])
    ('/env/lib/python3.11/site-packages/robot/arm.py', 7)
    >>> own_frame([(f"{packages}/click/core.py", 7), (f"{sysconfig.get_path('stdlib')}/selectors.py", 468)])
    """
    others = [(file, line) for file, line in frames if not file.startswith("<") and not _calls_systems(file)]
    own = [(file, line) for file, line in others if not _of_python_or_package(file)]
    of_packages = [(file, line) for file, line in others if _of_package(file)]
    called = [(file, line) for file, line in of_packages if _same_package(file, of_packages[0][0])]
    return next(reversed(own or called), None)


def _calls_systems(file: str) -> bool:
    return of_perfbound(file) or (_of_package(file) and COMMAND_LINE in Path(file).parts)


def _of_package(file: str) -> bool:
    return bool(PACKAGES.intersection(Path(file).parts))


def _same_package(file: str, other: str) -> bool:
    folder = Path(other).parent
    return file == other or (folder.name not in PACKAGES and Path(file).is_relative_to(folder))


def of_perfbound(file: str) -> bool:
    """Whether a source file is one of perfbound."""
    return Path(file).is_relative_to(PERFBOUND)


def _of_python_or_package(file: str) -> bool:
    path = Path(file)
    # A compiled module names its source relative to the folder in which it was built.
    compiled = not path.is_absolute()
    return compiled or _of_package(file) or path.is_relative_to(sysconfig.get_path("stdlib"))


def short_path(file: str) -> str:
    """Return a path, or one with more behind it, from the current directory if it is in there."""
    return os.path.relpath(file) if Path(file).is_relative_to(Path.cwd()) else file

"""The fingerprint of a system: its source files, and the versions of the packages that they import."""

import ast
import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions, requires, version
from pathlib import Path

LARGEST = 2**20
"""Bytes of a file of an installed package that belongs to its code; larger ones are data."""
REQUIREMENT = re.compile(r"[A-Za-z0-9._-]+")
CACHES = frozenset({"__pycache__"})
LOADED_BEFORE = frozenset({"numpy", "pydantic"})
"""Packages that every process of perfbound imports before any system: a file of that name beside it is not executed."""


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_of_module(name: str) -> tuple[list[Path], Path]:
    """Return the files of an installed module, and the folder from which they are named.

    Of a package they are those of its folder, named from the folder above, else the file and what it imports beside.
    Files of a package above 1 MB are data, and not among them.
    """
    found = importlib.util.find_spec(name)
    if found is None or found.origin is None:
        return [], Path()
    file = Path(found.origin)
    if found.submodule_search_locations is None:
        return (sorted(sources_of(file)) if file.is_file() else []), file.parent
    files = (each for each in file.parent.rglob("*") if each.is_file() and not CACHES.intersection(each.parts))
    return [each for each in files if each.stat().st_size <= LARGEST], file.parent.parent


def code_of_files(files: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return file -> sha256, by names relative to `folder`, sorted."""
    return {str(each.relative_to(folder)): file_sha256(each) for each in sorted(files)}


def sources_of(file: Path) -> set[Path]:
    """Return a Python file and those of its folder and below that it imports anywhere, also inside its functions."""
    known: set[Path] = set()
    waiting = [file]
    while waiting:
        source = waiting.pop()
        if source not in known:
            known.add(source)
            waiting += (each for each in _imported_files(source, file.parent) if each.is_relative_to(file.parent))
    return known


def versions_of(files: Iterable[Path], modules: Iterable[str] = ()) -> dict[str, str]:
    """Return distribution -> version of the installed packages that Python files import, perfbound left out.

    Of the packages that these require in turn as well. `modules` are further ones that were imported. What else a
    process has loaded changes nothing: every worker finds the same.
    """
    names = {name for file in files for level, name in imports_of(file.read_bytes()) if not level} | set(modules)
    outside = {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names) - {"perfbound", "__future__"}
    direct = dict(each for name in outside if (each := _distribution(name)))
    return dict(sorted((required_by(*direct) | direct).items()))


def required_by(*names: str) -> dict[str, str]:
    """Return distribution -> version of the installed ones that some require, and those in turn; without extras."""
    found: dict[str, str] = {}
    waiting = list(names)
    while waiting:
        for name, number in _required(waiting.pop()):
            if name not in found:
                found[name] = number
                waiting.append(name)
    return found


def _required(name: str) -> Iterator[tuple[str, str]]:
    """Yield the installed distributions that one requires, without its extras, and their versions."""
    for line in requires(name) or ():
        match = REQUIREMENT.match(line)
        if match is None or "extra ==" in line:
            continue
        with suppress(PackageNotFoundError):  # one of another platform or Python
            found = distribution(match[0])
            if (known := found.metadata["Name"]) != "perfbound":
                yield known, found.version


def _imported_files(source: Path, folder: Path) -> Iterator[Path]:
    for level, name in imports_of(source.read_bytes()):
        if not level and name.partition(".")[0] in LOADED_BEFORE:
            continue
        base = source.parents[level - 1] if level else folder
        path = base.joinpath(*filter(None, name.split(".")))
        # Of `from a.b import c`, c may be a module or a name in a/b.py; of a package its __init__ runs, too.
        for each in (path, *path.parents):
            if each == base or not each.is_relative_to(base):
                break
            yield from (file for file in (each.with_suffix(".py"), each / "__init__.py") if file.is_file())


def imports_of(content: bytes) -> tuple[tuple[int, str], ...]:
    """Return (level, dotted name) of every import statement of a file, wherever it stands; level 0 is absolute."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):
        return ()  # no Python; importing it says so
    found: list[tuple[int, str]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += ((0, each.name) for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            found += ((node.level, f"{node.module or ''}.{each.name}".strip(".")) for each in node.names)
    return tuple(found)


def _distribution(name: str) -> tuple[str, str] | None:
    """Return the distribution of a top-level module, and its version; None for a module that is in none."""
    try:
        # Under its own name, as `_required` has it: both spellings of one would be two packages.
        found = distribution(name)
        return found.metadata["Name"], found.version
    except PackageNotFoundError:
        for other in _distributions_by_module().get(name, ()):  # as of `sklearn`
            return other, version(other)
    return None


@cache
def _distributions_by_module() -> Mapping[str, list[str]]:
    return packages_distributions()  # takes a while

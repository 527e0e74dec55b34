"""The modules of a system outside its folder: of PYTHONPATH, of an editable installation, or in an archive.

Those of Python, of installed distributions, which have a version, and of perfbound are none of them. Machines may have
the others in different folders, so that `module NAME` stands for each, and no path.
"""

import hashlib
import os
import sys
import sysconfig
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import NamedTuple

from ...schemas.errors import DefinitionError
from ...schemas.places import PACKAGES, of_perfbound
from .declared import MOST_FILES
from .fingerprint import file_sha256, imports_of

PREFIX = "module "
"""Of the name of such a module among the code of a system."""
MODULE = "perfbound_system"
"""Name of the module of a file; its own would hide an installed one."""
NEVER = frozenset({"perfbound", "__main__", "__mp_main__", MODULE})
"""Top-level modules that are no code of a system, or are among it by their file."""
COMPILED = (".so", ".pyd")
OF_PYTHON = tuple({os.path.join(sysconfig.get_path(each), "") for each in ("stdlib", "platstdlib")})
INSTALLED = tuple(f"/{each}/" for each in PACKAGES)


class Module(NamedTuple):
    """A module that is or can be imported."""

    name: str
    place: Path
    """Its file; of one in an archive, a path into that."""
    spec: ModuleSpec

    @property
    def sha256(self) -> str:
        """The digest of its file."""
        return file_sha256(self.place) if self.place.is_file() else hashlib.sha256(self._content()).hexdigest()

    @property
    def file(self) -> Path:
        """The file that Python opens for it: the archive, if it is in one."""
        return next((each for each in (self.place, *self.place.parents) if each.is_file()), self.place)

    def imports(self) -> Iterator[str]:
        """Yield the absolute names that it imports, wherever the statement stands."""
        if self.place.suffix != ".py":
            return
        package = self.name if self.spec.submodule_search_locations is not None else self.name.rpartition(".")[0]
        for level, name in imports_of(self._content()):
            parts = package.split(".")
            base = parts[: len(parts) - level + 1] if level else []
            yield ".".join(filter(None, [*base, name]))

    def _content(self) -> bytes:
        if self.place.is_file():
            return self.place.read_bytes()
        return bytes(self.spec.loader.get_data(str(self.place)))  # type: ignore[union-attr]


def modules_elsewhere(sources: Iterable[Path], loaded: Collection[str] = ()) -> dict[str, Module]:
    """Return name -> module of what Python files import that is no installed package, and what those import in turn.

    Also inside of functions. `loaded` are modules that were imported; others are those of the search path, whatever
    else this process has loaded under their names.

    Raises:
        DefinitionError: they are too many.

    """
    waiting = [*loaded, *(name for file in sources for level, name in imports_of(file.read_bytes()) if not level)]
    found, seen = dict[str, Module](), set[str]()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        for module in _chain(name, loaded):
            if module.name not in found:
                found[module.name] = module
                waiting += module.imports()
        if len(found) > MOST_FILES:
            raise DefinitionError(f"it imports more than {MOST_FILES} modules; install those of others with pip")
    return dict(sorted(found.items()))


def digests_of(modules: Iterable[Module]) -> dict[str, str]:
    """Return the name of each module among the code of a system, and the digest of its file."""
    return {PREFIX + each.name: each.sha256 for each in modules}


def loaded_elsewhere(before: Collection[str] = ()) -> dict[str, Module]:
    """Return name -> module of those in this process that are no installed package, and were not there `before`."""
    new = [(name, module) for name, module in [*sys.modules.items()] if name not in before]
    found = (_module(name, getattr(module, "__spec__", None)) for name, module in new)
    return {each.name: each for each in found if each is not None and _counts(each)}


def forget(names: Iterable[str]) -> None:
    """Have Python import modules anew, but those of a package with a compiled part, which it can import once alone."""
    # Also those whose file is gone.
    places = {name: str(getattr(sys.modules[name], "__file__", None) or "") for name in names if name in sys.modules}
    kept = {_top(name) for name, place in places.items() if place.endswith(COMPILED)}
    for name in places:
        if _top(name) not in kept:
            del sys.modules[name]


def file_of(name: str) -> Path | None:
    """Return the file here of a module among the code of a system, `module NAME`; None for another name."""
    *_, last = (None, *_chain(name.removeprefix(PREFIX), sys.modules)) if name.startswith(PREFIX) else (None,)
    return None if last is None else last.file


def is_code(place: Path) -> bool:
    """Whether a file is none of Python, of an installed distribution, or of perfbound."""
    text = str(place)  # not by its parts: a process has a thousand modules
    return not (
        text.startswith(OF_PYTHON)
        or any(each in text for each in INSTALLED)
        or of_perfbound(text)
        or any(
            str(place.relative_to(each)) in _recorded(each)
            for each in map(os.path.abspath, sys.path)
            if place.is_relative_to(each)
        )
    )


@cache
def _recorded(folder: str) -> frozenset[str]:
    """Return the files of a folder that distributions in it record as theirs, as `pip install --target` makes them."""
    lines = (
        line.rsplit(",", 2)[0].strip('"')
        for record in Path(folder).glob("*.dist-info/RECORD")
        for line in record.read_text(errors="replace").splitlines()
    )
    return frozenset(lines)


def _top(name: str) -> str:
    return name.partition(".")[0]


def _counts(module: Module) -> bool:
    return _top(module.name) not in NEVER and is_code(module.place)


def _chain(name: str, loaded: Collection[str]) -> Iterator[Module]:
    """Yield a module and those above it, from the top, as far as there are any: of `a.b.c`, c may be a name in a.b."""
    path: Sequence[str] | None = None
    parts = name.split(".")
    if parts[0] in NEVER:
        return
    for k in range(len(parts)):
        each = ".".join(parts[: k + 1])
        spec = getattr(sys.modules.get(each), "__spec__", None) if each in loaded else _spec(each, path)
        module = _module(each, spec)
        if module is not None:
            if not is_code(module.place):
                return
            yield module
        if spec is None or spec.submodule_search_locations is None:
            return
        path = list(spec.submodule_search_locations)


def _module(name: str, spec: ModuleSpec | None) -> Module | None:
    if spec is None or not getattr(spec, "has_location", False) or not spec.origin:
        return None  # built in, frozen, a folder without __init__.py, or made by a program
    found = Module(name, Path(os.path.abspath(spec.origin)), spec)
    return found if found.place.is_file() or (found.file.is_file() and hasattr(spec.loader, "get_data")) else None


def _spec(name: str, path: Sequence[str] | None) -> ModuleSpec | None:
    """Return how Python finds a module, without importing those above it."""
    for finder in sys.meta_path:
        with suppress(ImportError, AttributeError):
            if (spec := finder.find_spec(name, path, None)) is not None:
                return spec
    return None

"""Systems in files: `FILE.py:NAME`, and the fingerprint of the code behind them."""

import hashlib
import importlib.util
import sys
import sysconfig
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from ...schemas.errors import DefinitionError
from ...schemas.system import SystemSpec
from ...schemas.trajectory import Trajectory, Visual
from .base import SystemUnderTest

MODULE = "perfbound_system"
"""Name of the module of a file; its own would hide an installed one."""
INSTALLED = frozenset({"site-packages", "dist-packages"})
"""Folders of packages; an environment often lies beside the campaign."""


def load_file(reference: str) -> SystemUnderTest:
    """Return the system `FILE.py:NAME`; its spec carries the digests of the file and of what it imports beside it.

    Raises:
        DefinitionError: the file or the name is not there, or is no system, or the file cannot be imported.

    """
    text, _, name = reference.rpartition(":")
    path = Path(text).absolute()
    # Anew, also what another system of this folder has imported: the code of each is what it imports itself.
    for known in list(_beside(path.parent)):
        del sys.modules[known]
    module = _imported(path)
    found = getattr(module, name, None)
    if found is None:
        raise DefinitionError(f"{path}: there is no {name!r} in it; name a function under @perfbound.system")
    if isinstance(found, type) and hasattr(found, "rollout"):  # a class like that of an installed system
        found = found()
    if not (hasattr(found, "spec") and hasattr(found, "rollout")):
        raise DefinitionError(f"{path}: {name} is {type(found).__name__} and no system; put @perfbound.system above it")
    system: SystemUnderTest = found
    sources = {path, *_beside(path.parent).values()}
    return _WithCode(system, {str(each.relative_to(path.parent)): _sha256(each) for each in sorted(sources)})


def _beside(folder: Path) -> dict[str, Path]:
    """Return the sources of the loaded modules in a folder and below, without installed packages and perfbound."""
    found = {name: Path(file) for name, module in sys.modules.items() if (file := getattr(module, "__file__", None))}
    return {
        name: file
        for name, file in found.items()
        if file.is_relative_to(folder)
        and not INSTALLED.intersection(file.parts)
        and not file.is_relative_to(sysconfig.get_path("stdlib"))
        and name.partition(".")[0] not in {"perfbound", "__main__", MODULE}
    }


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _imported(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(MODULE, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise DefinitionError(f"{path}: there is no such Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[MODULE] = module
    folder = str(path.parent)
    # In front while the file is imported, as for a script; afterwards behind all installed ones, for late imports.
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except DefinitionError as error:
        raise DefinitionError(f"{path}: {error}") from None
    except SyntaxError as error:
        raise DefinitionError(f"{error.filename}, line {error.lineno}: {error.msg}") from None
    except (Exception, SystemExit) as error:  # noqa: BLE001  (any: untrusted code; the reason is in the message)
        place = next(
            (each for each in reversed(traceback.extract_tb(error.__traceback__)) if each.filename == str(path)), None
        )
        where = f"{path}, line {place.lineno}" if place else str(path)
        raise DefinitionError(f"{where}: {type(error).__name__}: {error}") from None
    finally:
        sys.path.remove(folder)
        sys.path.append(folder)
    return module


class _WithCode(SystemUnderTest):
    """A system whose spec names the code behind it."""

    def __init__(self, system: SystemUnderTest, code: dict[str, str]) -> None:
        self._system = system
        self._spec = system.spec.model_copy(update={"code": code})

    @property
    def spec(self) -> SystemSpec:
        return self._spec

    def rollout(self, x: Sequence[float], **arguments: Any) -> Trajectory:
        return self._system.rollout(x, **arguments)

    def visual(self, trajectory: Trajectory) -> Visual | None:
        return self._system.visual(trajectory)

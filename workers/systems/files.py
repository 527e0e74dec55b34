"""Systems in files: `FILE.py:NAME` or a program, and the fingerprint of the code behind them."""

import importlib
import importlib.util
import sys
import sysconfig
import traceback
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from ...schemas.errors import DefinitionError, UnknownSystemError, meant
from ...schemas.file.config import CampaignConfig
from ...schemas.file.reader import load_description
from ...schemas.file.space import SystemChoice
from ...schemas.places import PACKAGES
from ...schemas.system import Variant
from ..faults import NOT_OF_SYSTEMS, reason
from .base import SystemUnderTest
from .declared import DeclaredFiles, WithSpec, declared_files
from .described import check_horizon
from .elsewhere import MODULE, Module, digests_of, forget, loaded_elsewhere, modules_elsewhere
from .fingerprint import code_of_files, sources_of, versions_of
from .pair import Half, TwoSimulators
from .program import load_program
from .rig import load_rig

_ELSEWHERE: set[str] = set()
"""Modules outside the folder of a system that this process has imported with it."""
_LATE: list[str] = []
"""Folders of systems, which are in the search path for their late imports."""


def load_reference(reference: str) -> SystemUnderTest:
    """Return the system `FILE.py:NAME`, or the one that a campaign file names.

    Raises:
        DefinitionError: it cannot be loaded; a campaign file that names an installed system is refused, too.
        CampaignError: the campaign file cannot be read.

    """
    if not reference.endswith(".toml"):
        return load_file(reference)
    path = Path(reference)
    return _described(path, load_description(path))


def _described(path: Path, config: CampaignConfig) -> SystemUnderTest:
    """Return the system of a campaign that was read from `path`."""
    match config.system.kind:
        case "program":
            program = load_program(path, config)
            return WithSpec(program, program.declared)
        case "gymnasium":
            from .environment import load_environment  # noqa: PLC0415  (needs an extra)

            return load_environment(path, config)
        case "fmu":
            from .fmu import load_fmu  # noqa: PLC0415  (needs an extra)

            return load_fmu(path, config)
        case "mjcf":
            from .mjcf import load_mjcf  # noqa: PLC0415  (needs an extra)

            return load_mjcf(path, config)
        case "rig":
            return load_rig(path, config)
        case "python":
            return load_file(str(path.absolute().parent / (config.system.python or "")), config.system, path)
        case "nominal":
            return _both(path, config)
    raise DefinitionError(f"{path}: its system {config.system.name!r} is installed, and needs no reference")


def _both(path: Path, config: CampaignConfig) -> TwoSimulators:
    """Return the two simulators of a campaign; one may be missing here.

    Raises:
        DefinitionError: both are missing, or one has not what the file says.

    """
    from . import load_system  # noqa: PLC0415  (it imports this module late)

    pair, halves = config.system, dict[Variant, Half | str]()
    for variant, choice in pair.simulators.items():
        part = config.model_copy(update={"system": choice})
        try:
            system = load_system(choice.name) if choice.name else _described(path, part)
            check_horizon(config.horizon or None, getattr(system, "step", None) or 0.0, str(path))
        except (DefinitionError, UnknownSystemError) as error:
            halves[variant] = str(error).removeprefix(f"{path}: ")
            continue
        try:
            halves[variant] = Half(system, variant, choice, pair.columns or {}, pair.label)
        except DefinitionError as error:
            raise DefinitionError(f"{path}: system.{error}") from None
    reasons = [each for each in halves.values() if isinstance(each, str)]
    if len(reasons) == len(halves):
        raise DefinitionError(f"{path}: system: " + "; ".join(reasons))
    return TwoSimulators(pair.label, halves)


def load_file(reference: str, said: SystemChoice | None = None, campaign: Path | None = None) -> SystemUnderTest:
    """Return the system `FILE.py:NAME`; its spec carries the digests of the file and of the modules that it imports.

    The digests of the files that it declares are in the spec, too, and the versions of the packages that it imports.
    `said` is what the file `campaign` says of it besides.

    Raises:
        DefinitionError: the file or the name is not there, or is no system, or the file cannot be imported.

    """
    text, _, name = reference.rpartition(":")
    path = Path(text).absolute()
    code = loaded_code(path)
    found = getattr(code.module, name, None)
    if found is None:
        own = [
            each for each, value in vars(code.module).items() if hasattr(value, "spec") and hasattr(value, "rollout")
        ]
        hint = meant(name, own) or (f"its systems are {', '.join(own)}; " if own else "")
        raise DefinitionError(f"{path}: there is no {name!r} in it; {hint}name a function under @perfbound.system")
    if isinstance(found, type) and hasattr(found, "rollout"):  # a class like that of an installed system
        found = found()
    if not (hasattr(found, "spec") and hasattr(found, "rollout")):
        raise DefinitionError(f"{path}: {name} is {type(found).__name__} and no system; put @perfbound.system above it")
    system: SystemUnderTest = found
    # A class need not derive from the port.
    declared = _declared(getattr(system, "files", ()), path, path.parent) | (
        {} if campaign is None or said is None else _declared(said.files or (), campaign.absolute(), path.parent)
    )
    found_files = DeclaredFiles({name: each for name, each in declared.items() if each not in code.sources})
    keys: dict[str, Any] = {
        "code": code.digests | found_files.digests,
        "versions": code.versions | system.spec.versions,
    }
    if said is not None:
        try:
            spec = system.spec.with_said(said.stamps, said.after_end)
        except DefinitionError as error:
            raise DefinitionError(f"{campaign}: system.{error}") from None
        keys |= {key: getattr(spec, key) for key in ("stamps", "after_end", "columns")}
    return WithSpec(system, found_files, **keys)


class LoadedCode(NamedTuple):
    """A Python file that was imported, and what it consists of."""

    module: ModuleType
    sources: Collection[Path]
    digests: dict[str, str]
    """Name -> sha256 of the file and of what it imports that is no installed package."""
    versions: dict[str, str]
    """Of the packages that it imports."""


def loaded_code(path: Path) -> LoadedCode:
    """Import a Python file as the code of a system.

    Raises:
        DefinitionError: it is not there, or cannot be imported.

    """
    folder = path.parent
    with _without_others(folder):
        # Anew, also what another system has imported: the code of each is what it imports itself.
        for known in list(_beside(folder)):
            del sys.modules[known]
        forget(_ELSEWHERE)
        before = frozenset(sys.modules)
        module = _imported(path)
        # What it has imported, by whatever way, and what its functions will import.
        beside = _beside(folder)
        new = loaded_elsewhere(before).keys() - beside.keys()
        _ELSEWHERE.update(new)
        bound = (each for own in (module, *map(sys.modules.get, beside)) for each in vars(own).values())
        # Also what importlib has imported by a computed name.
        modules = {each.__name__ for each in bound if isinstance(each, ModuleType) and each.__name__ not in beside}
        with _blaming(path):
            found = modules_elsewhere(sources_of(path) | set(beside.values()), modules | new | beside.keys())
        return _code_of(module, sources_of(path) | set(beside.values()), found.values(), modules | new, folder)


def _code_of(
    module: ModuleType, sources: set[Path], found: Collection[Module], modules: Collection[str], folder: Path
) -> LoadedCode:
    """Return the module of a file with its code: `sources`, and those `found`; `modules` are all that were imported."""
    beside = [each for each in found if each.place.is_relative_to(folder) and each.place.is_file()]
    sources = sources | {each.place for each in beside}
    elsewhere = [each for each in found if each not in beside]
    code = code_of_files(sources, folder) | digests_of(elsewhere)
    names = {name for each in elsewhere for name in each.imports()} | set(modules)
    return LoadedCode(module, sources | {each.place for each in elsewhere}, code, versions_of(sources, names))


def import_beside(name: str, folder: Path) -> None:
    """Import a module of a folder anew, if it is there, in place of one of its name from elsewhere."""
    path = folder.joinpath(*name.split("."))
    if path.with_suffix(".py").is_file() or (path / "__init__.py").is_file():
        sys.modules.pop(name, None)
        with _in_front(str(folder)):
            importlib.import_module(name)


def code_beside(folder: Path, *modules: str) -> dict[str, str]:
    """Return name -> sha256 of what has been imported from a folder and below, with what that imports.

    And of `modules`, where these are no installed packages.
    """
    sources = {each for file in _beside(folder).values() for each in sources_of(file)}
    found = modules_elsewhere(sources, modules).values()
    return code_of_files(sources, folder) | digests_of(each for each in found if not each.file.is_relative_to(folder))


def _declared(files: object, place: Path, base: Path) -> dict[str, Path]:
    with _blaming(place):
        return declared_files(files, place.parent, base)


@contextmanager
def _blaming(place: Path) -> Iterator[None]:
    try:
        yield
    except DefinitionError as error:
        raise DefinitionError(f"{place}: {error}") from None


def _beside(folder: Path) -> dict[str, Path]:
    """Return the sources of the loaded modules in a folder and below, without installed packages and perfbound."""
    found = {name: Path(file) for name, module in sys.modules.items() if (file := getattr(module, "__file__", None))}
    return {
        name: file
        for name, file in found.items()
        if file.is_relative_to(folder)
        and not PACKAGES.intersection(file.parts)  # an environment often lies beside the campaign
        and not file.is_relative_to(sysconfig.get_path("stdlib"))
        and name.partition(".")[0] not in {"perfbound", "__main__", MODULE}
    }


_loading: list[Path] = []


def loading() -> Path | None:
    """Return the file that is being loaded as a system, by the code that it runs at its top; None otherwise."""
    return _loading[-1] if _loading else None


def _imported(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(MODULE, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise DefinitionError(f"{path}: there is no such Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[MODULE] = module
    _loading.append(path)
    try:
        with _in_front(str(path.parent)):
            spec.loader.exec_module(module)
    except DefinitionError as error:
        raise DefinitionError(f"{path}: {error}") from None
    except SyntaxError as error:
        raise DefinitionError(f"{error.filename}, line {error.lineno}: {error.msg}") from None
    except NOT_OF_SYSTEMS:
        raise
    except BaseException as error:  # noqa: BLE001  (any: untrusted code; the reason is in the message)
        place = next(
            (each for each in reversed(traceback.extract_tb(error.__traceback__)) if each.filename == str(path)), None
        )
        where = f"{path}, line {place.lineno}" if place else str(path)
        raise DefinitionError(f"{where}: {reason(error)}") from None
    finally:
        _loading.pop()
    return module


@contextmanager
def _in_front(folder: str) -> Iterator[None]:
    """Look into a folder first while a file of it is imported, as for a script; and later last, for late imports."""
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        if folder not in sys.path:
            sys.path.append(folder)
            _LATE.append(folder)


@contextmanager
def _without_others(folder: str | Path) -> Iterator[None]:
    """Look into no folder of another system of this process: workers that have this one alone find the same."""
    others = [each for each in _LATE if each != str(folder) and each in sys.path]
    for each in others:
        sys.path.remove(each)
    try:
        yield
    finally:
        sys.path += others

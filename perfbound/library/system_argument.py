"""The system of a campaign, given as a function, a class, a name or a rig: how other processes find it, if they can."""

import hashlib
import inspect
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import CodeType
from typing import Any, cast

from ..orchestrator.fleet.children import child
from ..schemas.errors import CampaignError, DefinitionError, PerfboundError
from ..schemas.system import SystemSpec
from ..workers.systems.base import SystemUnderTest
from ..workers.systems.declared import DeclaredFiles, WithSpec, declared_files
from ..workers.systems.files import loading
from .rig import Rig


@dataclass(frozen=True)
class GivenSystem:
    """A system under test."""

    spec: SystemSpec
    reference: str
    """The system as a worker finds it: its name, FILE.py:NAME, or the campaign file of a program."""
    choice: dict[str, Any]
    """Its keys of `[system]`; none for a program, which a campaign file describes."""
    step: float | None = None
    """Seconds between two samples, where the time of a sample follows from its number."""
    here: SystemUnderTest | None = None
    """The system itself, where no other process can import it."""
    reason: str = ""
    """Why no other process can import it."""


def given_system(system: object, where: str) -> GivenSystem:
    """Return the system that was given to `where`.

    Raises:
        CampaignError: it is none, it is not installed, or its file cannot be used.
        DefinitionError: the file that calls this is being loaded as a system itself.

    """
    if (file := loading()) is not None:
        # Without this every child that loads the file would begin a campaign, whose children load it again.
        raise DefinitionError(
            f"{file}{_line_in(file)}: workers load this file for its system, and that must not call pb.Campaign; put "
            "this call and what follows under `if __name__ == '__main__':`, or into another file"
        )
    if isinstance(system, Rig):
        return GivenSystem(system.spec, system.spec.name, system.choice, system.step)
    if isinstance(system, str | Path):
        return _referenced(str(system), where)
    found: Any = system() if isinstance(system, type) and hasattr(system, "rollout") else system
    if not (hasattr(found, "spec") and hasattr(found, "rollout")):
        raise CampaignError(
            f"{where}: system: {type(system).__name__} is no system; put @perfbound.system above the function, or give "
            'the name of an installed one, or "FILE.py:NAME"'
        )
    return _given(system, cast(SystemUnderTest, found), where)


def _line_in(file: Path) -> str:
    """Return the line of a file that is running, as text."""
    lines = [each.lineno for each in inspect.stack(0) if Path(each.filename) == file]
    return f", line {lines[-1]}" if lines else ""


def _referenced(text: str, where: str) -> GivenSystem:
    found = child.resolved(text)
    if ".py:" in found:
        file, _, name = found.rpartition(":")
        return _in_file(Path(file).absolute(), name, where)
    spec = child.system_spec(found, f"{where}: system")
    return GivenSystem(spec, found, {}) if child.in_file(found) else _known_by_name(spec)


def _known_by_name(spec: SystemSpec, step: float | None = None) -> GivenSystem:
    return GivenSystem(spec, spec.name, {"name": spec.name}, step)


def _in_file(path: Path, name: str, where: str) -> GivenSystem:
    reference = f"{path}:{name}"
    return GivenSystem(child.system_spec(reference, f"{where}: system"), reference, {"python": f"{path.name}:{name}"})


def _given(system: object, found: SystemUnderTest, where: str) -> GivenSystem:
    """Return an object of this process, by its file where that defines it, else as it is."""
    step = getattr(found, "step", None)
    target: Any = inspect.unwrap(cast(Any, system)) if callable(system) else type(system)
    try:
        file = Path(inspect.getsourcefile(target) or "")
    except TypeError:
        file = Path()
    names = vars(sys.modules.get(str(target.__module__), object))
    name = next((name for name, value in names.items() if value is system and name.isidentifier()), None)
    if file.suffix != ".py" or not file.is_file() or name is None:
        return _session(target, found, "no file defines it", step)
    try:
        there = _in_file(file.absolute(), name, where)
    except PerfboundError as error:
        return _session(target, found, str(error), step)
    if _without_code(there.spec) != _without_code(found.spec):
        return _session(target, found, f"{file} defines another {name}", step)
    return replace(there, step=step)


def _session(target: object, found: SystemUnderTest, reason: str, step: float | None) -> GivenSystem:
    """Return a system that no file gives: an installed one, whose package imports it, or one of this process alone."""
    installed = child.system_specs().get(found.spec.name)
    if installed is not None and _without_code(installed) == _without_code(found.spec):
        return _known_by_name(installed, step)
    try:
        kind, text = "text", inspect.getsource(cast(Any, target))
    except (OSError, TypeError):  # typed into an interpreter that keeps no text
        kind, text = "bytecode", "\n".join(_bytecode(target))
    name = found.spec.name
    try:
        declared = DeclaredFiles(declared_files(getattr(found, "files", ()), Path.cwd()))
    except DefinitionError as error:
        raise CampaignError(f"{name}: {error}") from None
    code = {f"{name} (its own {kind})": hashlib.sha256(text.encode()).hexdigest()} | declared.digests
    spec = found.spec.model_copy(update={"code": code, "repeated": "session"})
    return replace(
        _known_by_name(spec, step), here=WithSpec(found, declared) if declared.digests else found, reason=reason
    )


def _bytecode(target: object) -> Iterator[str]:
    """Yield what a function, or the methods of a class, do: instructions, names and constants, without places."""
    code = getattr(target, "__code__", target)
    if isinstance(code, CodeType):
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames}"
        for constant in code.co_consts:
            # The order of a set of texts differs from process to process.
            listed = sorted(map(repr, constant)) if isinstance(constant, frozenset) else repr(constant)
            yield from _bytecode(constant) if isinstance(constant, CodeType) else [f"{listed}"]
        yield f"{getattr(target, '__defaults__', None)} {getattr(target, '__kwdefaults__', None)}"
    elif isinstance(target, type):
        for name, member in sorted(vars(target).items()):
            if hasattr(member, "__code__"):
                yield name
                yield from _bytecode(member)


def _without_code(spec: SystemSpec) -> SystemSpec:
    """Return what a system says of itself, without what its loader adds."""
    return spec.model_copy(update={"code": {}, "versions": {}})

"""Imports between the rooms, read from the source by `ast`."""

import ast
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = "perfbound"
FOLDERS = ("orchestrator", "schemas", "workers")
DIVIDED = "orchestrator"
"""The folder whose subfolders are rooms; each other folder is one room."""


def imports() -> dict[str, set[str]]:
    """Return the rooms that each room imports; imports inside functions and for types count."""
    found: dict[str, set[str]] = defaultdict(set)
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*.py"):
            _add(found, path.relative_to(ROOT).with_suffix("").parts, path)
    # Not rglob: the links of the package lead to the folders above.
    for path in (ROOT / PACKAGE).glob("*.py"):
        _add(found, (path.stem,), path)
    return dict(found)


def _add(found: dict[str, set[str]], module: Sequence[str], path: Path) -> None:
    room = _room(module)
    if room is not None:
        targets = {_room(target) for target in _imported(module, path)}
        found[room] |= {target for target in targets if target is not None} - {room}


def _room(module: Sequence[str]) -> str | None:
    """Return the room of a module of the package; None for a module between the rooms, such as `__main__`."""
    if module[0] not in FOLDERS:
        return PACKAGE
    if module[0] != DIVIDED:
        return module[0]
    inside = len(module) > 1 and (ROOT / DIVIDED / module[1]).is_dir()
    return module[1] if inside else None


def _imported(module: Sequence[str], path: Path) -> Iterator[tuple[str, ...]]:
    """Yield every name that a module imports from the package, with its path below the package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            above = tuple(module[: len(module) - node.level])
            inside = tuple(node.module.split(".")) if node.module else ()
            yield from (above + inside + (alias.name,) for alias in node.names)

"""The source code as `ast` reads it: modules, definitions with their sizes, imports between modules and rooms."""

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("orchestrator", "workers", "schemas", "perfbound/library")
FLOORS = (
    ("cli",),
    ("release",),
    ("prepare",),
    ("report",),
    ("run", "hosts"),
    ("certificate",),
    ("forecast",),
    ("campaign",),
    ("store", "fleet", "mathematics"),
)
"""The rooms of the orchestrator from the top to the ground; those of one floor are independent of one another."""
Function = ast.FunctionDef | ast.AsyncFunctionDef
Arrow = tuple[str, str]
"""Importing module and imported module."""


@cache
def modules() -> Mapping[str, ast.Module]:
    """Return the modules by their path, such as `orchestrator/run/session.py`."""
    paths = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text()) for path in paths}


def lines(module: str) -> int:
    """Return the number of lines of a file."""
    return (ROOT / module).read_text().count("\n")


@dataclass(frozen=True)
class Class:
    """A class and its size."""

    name: str
    """With its module, as `orchestrator/run/service.py:Service`."""
    lines: int
    methods: int


def classes() -> Iterator[Class]:
    """Yield every class."""
    for module, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                size = (node.end_lineno or node.lineno) - node.lineno + 1
                yield Class(f"{module}:{node.name}", size, sum(isinstance(each, Function) for each in node.body))


def parameters() -> Iterator[tuple[str, int]]:
    """Yield every function with the number of its parameters; without click commands, whose parameters are options."""
    for module, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, Function) and not any("click." in ast.unparse(each) for each in node.decorator_list):
                taken = node.args
                names = [each.arg for each in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs)]
                yield f"{module}:{node.name}", len(names) - (names[:1] in (["self"], ["cls"]))


def room(module: str) -> str:
    """Return the room of a module: a folder below orchestrator/, workers, or schemas.

    >>> room("orchestrator/run/session.py"), room("schemas/ids.py"), room("orchestrator/__main__.py")
    ('run', 'schemas', '__main__')
    """
    parts = module.removesuffix(".py").split("/")
    return parts[1] if parts[0] == "orchestrator" else parts[0]


def parts(folder: str) -> list[str]:
    """Return the folders with modules in a folder.

    >>> parts("orchestrator/prepare")
    ['calibrate', 'check_system', 'init', 'plan']
    """
    return sorted(path.parent.name for path in (ROOT / folder).glob("*/__init__.py"))


def arrows_of_rooms() -> set[Arrow]:
    """Return which room imports which, from imports anywhere in a module."""
    rooms = {(room(source), room(target)) for source, target in arrows(everywhere=True)}
    return {(one, other) for one, other in rooms if one != other and not {one, other} & {"__init__", "__main__"}}


def arrows(*, everywhere: bool) -> set[Arrow]:
    """Return which module imports which; `everywhere` counts imports inside functions and for types as well."""
    found = set()
    for module, tree in modules().items():
        nodes = ast.walk(tree) if everywhere else iter(tree.body)
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                found |= {(module, target) for target in _targets(module, node)}
    return found


def _targets(module: str, node: ast.ImportFrom) -> set[str]:
    """Return the modules of ours that an import names."""
    home = module.split("/")[: -node.level] if node.level else []
    parts = [*home, *(node.module or "").split(".")] if node.module else home
    # `perfbound` links to the other folders; one import of the library is relative to it, most are absolute.
    if parts[:1] == ["perfbound"] and parts[1:2] != ["library"]:
        parts = parts[1:]
    elif not node.level:
        parts = []
    found = set()
    for alias in node.names:
        for path in ([*parts, f"{alias.name}.py"], [*parts, alias.name, "__init__.py"]):
            if (name := "/".join(path)) in modules():
                found.add(name)
                break
        else:
            for name in ("/".join(parts) + ".py", "/".join([*parts, "__init__.py"])):
                if name in modules():
                    found.add(name)
    return found

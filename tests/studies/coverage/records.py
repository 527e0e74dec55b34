"""Results: one file of JSON lines a row, appended chunk by chunk, so that a killed study can continue.

A file is named by the digest of the row and of the code that its numbers depend on: other code, other file.
"""

import ast
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Protocol

ROOT = Path(__file__).parents[3]
DIRECTORY = Path("build/coverage")
MODULES = {
    "audit": "rigorous",
    "kriging-audit": "kriging",
    "controls": "controls.campaigns",
    "law-audit": "controls.wrong_laws",
    "comparison": "comparison.campaigns",
    "t-test": "comparison.campaigns",
}
"""Module of the campaigns of a kind, if it is not the module of its name."""

Chunk = dict[str, list[float]]
"""Results of the campaigns of one chunk, by name."""


class Row(Protocol):
    """One row of the study: a frozen dataclass of what defines its campaigns."""

    kind: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def claimed(self) -> float:
        """The failure probability that is claimed."""


def digest(row: Row) -> str:
    """Return what the seeds of a row come from: 16 hexadecimal digits of its definition."""
    text = json.dumps([row.kind, asdict(row)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def code(kind: str) -> str:
    """Return the digest of the code that the numbers of a kind depend on, and of the libraries: comments do not count.

    That is the module of its campaigns and what it imports of ours, directly or not.
    """
    texts = [
        f"{name}\n{_bare(_source(name))}"
        for name in sorted(_imported(f"tests.studies.coverage.{MODULES.get(kind, kind)}"))
    ]
    texts += [f"{name} {version(name)}" for name in ("numpy", "scipy", "scikit-learn")]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


def _imported(name: str) -> set[str]:
    """Return the names of our modules that module `name` needs, itself included."""
    found: set[str] = set()
    left = {name}
    while left:
        one = left.pop()
        found.add(one)
        nodes = [node for node in ast.walk(ast.parse(_source(one))) if isinstance(node, ast.ImportFrom)]
        for node in nodes:
            # Imports inside the product are relative.
            home = one.rsplit(".", node.level)[0] + "." if node.level else ""
            base = f"{home}{node.module or ''}".rstrip(".")
            names = (base, *(f"{base}.{each.name}" for each in node.names))
            left |= {name for name in names if _file(name).is_file()} - found
    return found


def _file(name: str) -> Path:
    return ROOT / f"{name.replace('.', '/')}.py"


def _source(name: str) -> str:
    return _file(name).read_text(encoding="utf-8")


def _bare(source: str) -> str:
    """Return the syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            node.value.value = ""
    return ast.dump(tree)


def path(row: Row, directory: Path = DIRECTORY) -> Path:
    """Return the file of a row."""
    return directory / f"{row.kind}-{digest(row)}-{code(row.kind)}.jsonl"


def append(row: Row, number: int, chunk: Chunk, directory: Path = DIRECTORY) -> None:
    """Write one chunk as one line; a line that a kill cut short is closed first, and ignored by `read`."""
    directory.mkdir(parents=True, exist_ok=True)
    line = json.dumps({"chunk": number, "results": chunk})
    with path(row, directory).open("a", encoding="utf-8") as file:
        file.write(f"\n{line}\n")
        file.flush()
        os.fsync(file.fileno())


def read(row: Row, directory: Path = DIRECTORY) -> dict[int, Chunk]:
    """Return the finished chunks of a row by their number."""
    file = path(row, directory)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return dict(_parsed(lines))


def _parsed(lines: Iterable[str]) -> Iterator[tuple[int, Chunk]]:
    for line in lines:
        try:
            found = json.loads(line)
            yield int(found["chunk"]), found["results"]
        except (ValueError, KeyError, TypeError):  # empty, or cut short by a kill: that chunk is run again
            continue


def together(chunks: dict[int, Chunk], count: int) -> Chunk:
    """Return the results of the first `count` chunks that are there, in the order of their numbers."""
    found: Sequence[Chunk] = [chunks[number] for number in sorted(chunks) if number < count]
    return {name: [value for chunk in found for value in chunk[name]] for name in (found[0] if found else ())}

"""Places of a module where no mutant is made, as `ast` finds them: what mypy or ruff alone checks, and what only costs.

This is apart from `changes.py`, since the tests of it have no Cosmic Ray.
"""

import ast
from collections.abc import Iterator
from typing import NamedTuple

WITHOUT_EFFECT = {"cache", "lru_cache", "overload", "override", "final", "abstractmethod", "runtime_checkable"}
"""Decorators of speed and of types."""
DECLARED = {"dataclass": {"frozen", "slots", "kw_only"}, "zip": {"strict"}}
"""Keywords of a call that promise what mypy or a caller keeps."""
PRAGMA = "# pragma"


class Position(NamedTuple):
    """Line, from 1, and column in characters, from 0."""

    line: int
    column: int


class Span(NamedTuple):
    """From one position up to another, which is outside."""

    start: Position
    stop: Position

    def covers(self, other: "Span") -> bool:
        """Whether the other one lies in this one."""
        return self.start <= other.start and other.stop <= self.stop


def left_out(source: str) -> list[Span]:
    """Return the spans of a module's text in which no mutant is made.

    >>> [(span.start.column, span.stop.column) for span in left_out("x: int | None = f(1)")]
    [(3, 13)]
    """
    lines = source.splitlines()
    found = [
        Span(Position(number, 0), Position(number + 1, 0)) for number, line in enumerate(lines, 1) if PRAGMA in line
    ]
    return found + [_span(node, lines) for each in ast.walk(ast.parse(source)) for node in _without_meaning(each)]


def _without_meaning(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    match node:
        case ast.arg(annotation=ast.expr() as annotation) | ast.AnnAssign(annotation=annotation):
            yield annotation
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            yield from (each for each in node.decorator_list if _name(each) in WITHOUT_EFFECT)
            if not isinstance(node, ast.ClassDef) and node.returns is not None:
                yield node.returns
        case ast.Assign(targets=[ast.Name(id=name)], value=value) if name == "__all__" or _is_type(name):
            yield value
        case ast.If(test=test) if _name(test) == "TYPE_CHECKING":
            yield node
        case ast.Call() if keywords := DECLARED.get(_name(node)):
            yield from (each.value for each in node.keywords if each.arg in keywords)


def _name(node: ast.expr) -> str:
    """Return the last part of what is named, called or decorated with."""
    match node:
        case ast.Call(func=func):
            return _name(func)
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
    return ""


def _is_type(name: str) -> bool:
    return name.lstrip("_")[:1].isupper() and not name.isupper()


def _span(node: ast.expr | ast.stmt, lines: list[str]) -> Span:
    """Return the place of a node; `ast` counts columns in bytes."""
    last, stop = node.end_lineno or node.lineno, node.end_col_offset or node.col_offset
    return Span(
        Position(node.lineno, _characters(lines[node.lineno - 1], node.col_offset)),
        Position(last, _characters(lines[last - 1], stop)),
    )


def _characters(line: str, count: int) -> int:
    return len(line.encode()[:count].decode())

"""A sample of mutants by seed, as JSON on stdout; Cosmic Ray finds the places and changes the text.

Run in an environment of its own, and in the tree that is mutated: `.venv-mutants/bin/python -m
tests.studies.mutants.changes --seed 1 --number 60`.

Every place has the same chance, and at a place every change of `OPERATORS`: those whose result is of the same type. A
sum that becomes a shift fails wherever it runs, so it would count a test of anything as a good one. The places are
ranked by digests of the seed and of their lines, so most of a sample stays as it is while other lines are edited.
"""

import argparse
import ast
import difflib
import hashlib
import json
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

from tests.studies.mutants.places import Position, Span, left_out

FOLDERS = ("orchestrator", "schemas", "workers", "perfbound/library")
REPLACED = {
    "Binary": [
        *(("Add", "Sub"), ("Sub", "Add"), ("Mul", "Div"), ("Div", "Mul"), ("FloorDiv", "Mul"), ("Mod", "FloorDiv")),
        *(("Pow", "Mul"), ("BitOr", "BitAnd"), ("BitAnd", "BitOr"), ("BitXor", "BitOr"), ("LShift", "RShift")),
        ("RShift", "LShift"),
    ],
    "Comparison": [
        *(("Eq", "NotEq"), ("NotEq", "Eq"), ("Is", "IsNot"), ("IsNot", "Is")),
        *(("Lt", "LtE"), ("Lt", "GtE"), ("LtE", "Lt"), ("LtE", "Gt")),
        *(("Gt", "GtE"), ("Gt", "LtE"), ("GtE", "Gt"), ("GtE", "Lt")),
    ],
    "Unary": [("USub", "UAdd"), ("Delete", "Not"), ("Delete", "Invert")],
}
OPERATORS = (
    *(f"core/Replace{kind}Operator_{one}_{other}" for kind, pairs in REPLACED.items() for one, other in pairs),
    "core/AddNot",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceAndWithOr",
    "core/ReplaceOrWithAnd",
    "core/ReplaceBreakWithContinue",
    "core/ReplaceContinueWithBreak",
    "core/ExceptionReplacer",
    "core/NumberReplacer",
    "core/RemoveDecorator",
    "core/ZeroIterationForLoop",
)


class Change(NamedTuple):
    """An operator of Cosmic Ray, and which of its places in the module."""

    operator: str
    occurrence: int


class Place(NamedTuple):
    """A place with its possible changes; sorted by its rank."""

    rank: str
    path: str
    span: Span
    changes: list[Change]


def main() -> int:
    """Print the sample; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.mutants.changes", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--number", type=int, required=True)
    options = parser.parse_args()
    found: list[dict[str, Any]] = []
    for place in sorted(place for path in _modules() for place in _places(path, options.seed)):
        if len(found) == options.number:
            break
        if mutant := _mutant(place):
            found.append(mutant)
    json.dump(found, sys.stdout)
    return 0


def _modules() -> list[Path]:
    return sorted(path for folder in FOLDERS for path in Path(folder).rglob("*.py"))


def _places(path: Path, seed: int) -> Iterator[Place]:
    source = path.read_text()
    lines, nodes = source.splitlines(), list(ast_nodes(get_ast(source)))
    changes: dict[Span, list[Change]] = defaultdict(list)
    for name in OPERATORS:
        operator = get_operator(name)()
        spans = (span for node in nodes for span in operator.mutation_positions(node))
        for occurrence, (start, stop) in enumerate(spans):
            changes[Span(Position(*start), Position(*stop))].append(Change(name, occurrence))
    without, seen = left_out(source), Counter[str]()
    for span in sorted(changes):
        if any(each.covers(span) for each in without):
            continue
        line = lines[span.start.line - 1]
        indent = len(line) - len(line.lstrip())
        text = f"{seed} {path} {span.start.column - indent} {line.strip()}"
        seen[text] += 1
        yield Place(_digest(f"{text} {seen[text]}"), str(path), span, changes[span])


def _mutant(place: Place) -> dict[str, Any] | None:
    """Return what the place becomes; nothing where that is the same program, or none."""
    source = Path(place.path).read_text()
    change = place.changes[int(place.rank, 16) % len(place.changes)]
    text = mutate_code(source, get_operator(change.operator)(), change.occurrence)
    try:
        if ast.dump(ast.parse(source)) == ast.dump(ast.parse(text)):
            return None
        compile(text, place.path, "exec")
    except SyntaxError:
        return None
    differing = [line for line in difflib.ndiff(source.splitlines(), text.splitlines()) if line[0] in "-+"]
    was, becomes = (" ".join(line[1:].strip() for line in differing if line[0] == sign) for sign in "-+")
    return {"path": place.path, "line": place.span.start.line, "was": was, "becomes": becomes, "text": text}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())

"""Formulas cite their equations, and the table of docs/theory.md names what is cited: both ways."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
THEORY = (ROOT / "docs" / "theory.md").read_text()
CITATION = re.compile(r"Implements (?:eq\. \(([^)]+)\)|(Algorithm \d+)) of \[([A-Z0-9]+)\]")
EXPLAINED, TABLE = THEORY.split("## Equations and the code")
ROW = re.compile(r"^\| \[([A-Z0-9]+)\] \| ([^|]+?) \|$", re.MULTILINE)
KEY = re.compile(r"^\| \[([A-Z0-9]+)\] \|", re.MULTILINE)


def docstrings() -> Iterator[tuple[str, str]]:
    """Yield (place, docstring) of everything in the orchestrator."""
    for path in sorted((ROOT / "orchestrator").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                name = getattr(node, "name", "module")
                yield f"{path.relative_to(ROOT)}:{name}", ast.get_docstring(node) or ""


def cited() -> set[tuple[str, str]]:
    return {
        (equation or algorithm, key)
        for _, text in docstrings()
        for equation, algorithm, key in CITATION.findall(text.replace("\n", " "))
    }


def test_the_table_names_what_the_code_cites_and_nothing_else() -> None:
    rows = ROW.findall(TABLE)
    named = [(equation, key) for key, equations in rows for equation in equations.split(", ")]
    assert len(named) == len(set(named))
    assert set(named) == cited()


def test_every_key_is_a_source() -> None:
    known = set(KEY.findall(EXPLAINED))
    assert {key for _, key in cited()} <= known
    assert "ARA" in known


def test_every_implements_is_a_citation_of_the_one_form() -> None:
    for place, text in docstrings():
        for line in text.splitlines():
            if line.strip().startswith("Implements"):
                assert CITATION.search(line), f"{place}: {line.strip()}"


def test_the_formulas_of_this_page_are_explained_in_it() -> None:
    for equation, key in cited():
        if key == "PB":
            assert f"({equation})" in EXPLAINED, f"({equation}) is cited and missing in docs/theory.md"

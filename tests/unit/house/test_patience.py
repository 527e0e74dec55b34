"""No test judges a time, and every wait has the one limit of `tests/patience.py`."""

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import PATIENCE

TESTS = Path(__file__).parents[2]
MEASURING = {"benchmarks", "coverage"}
"""Folders that are no tests of behaviour: they measure."""
FILES = sorted(path for path in TESTS.rglob("test_*.py") if not MEASURING & set(path.relative_to(TESTS).parts))
CLOCKS = {"perf_counter", "perf_counter_ns", "process_time", "process_time_ns", "thread_time", "timeit"}
WAITS = {"wait", "wait_for", "communicate", "settimeout", "timeout"}


def limits(tree: ast.Module) -> Iterator[str]:
    """Yield what waits for a number of seconds, or measures the speed of something."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute | ast.Name)
            and (node.attr if isinstance(node, ast.Attribute) else node.id) in CLOCKS
        ):
            yield f"line {node.lineno}: {ast.unparse(node)}"
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
            numbers = [each for each in node.args if name in WAITS and _is_number(each)]
            numbers += [each.value for each in node.keywords if each.arg == "timeout" and _is_number(each.value)]
            if numbers:
                yield f"line {node.lineno}: {ast.unparse(node)}"


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


@pytest.mark.rest
@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(TESTS)) for path in FILES])
def test_no_limit_but_the_one(path: Path) -> None:
    assert list(limits(ast.parse(path.read_text()))) == []


def test_the_limit_of_a_whole_test_is_above_that_of_its_waits() -> None:
    settings = tomllib.loads((TESTS.parent / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert settings["timeout"] >= 4 * PATIENCE

"""Sizes and arrows of the source code stay within their limits."""

import ast
import graphlib
from collections import defaultdict
from pathlib import Path

import pytest

from tests.architecture import source

FLOORS = {room: -floor for floor, rooms in enumerate((*source.FLOORS, ("schemas",))) for room in rooms}
ROOMS = set(FLOORS) - {"schemas"}
MODULE_LINES, CLASS_LINES, METHODS, PARAMETERS, ARROWS, FILES = 600, 300, 20, 7, 59, 25
SMALL = 60
"""Lines. A module below it with one importer belongs into that one, unless its first line says why it is apart."""

LARGE_MODULES: dict[str, str] = {}
"""Name -> reason, here and below. An entry that is no longer larger than the limit fails the test, too."""

LARGE_CLASSES: dict[str, str] = {}
MANY_PARAMETERS: dict[str, str] = {
    "orchestrator/mathematics/bounds/scenario.py:__init__": "keywords that say what is claimed of the rollouts",
    "workers/systems/decorator.py:system": "the public decorator: keywords, of which most have a default",
}


def test_the_orchestrator_has_its_rooms_and_no_loose_module() -> None:
    found = {path.name for path in (source.ROOT / "orchestrator").iterdir() if path.name != "__pycache__"}
    assert found == {*ROOMS, "__init__.py", "__main__.py"}


def test_no_folder_has_many_files() -> None:
    folders = [
        source.ROOT / name for name in ("docs", "deploy", "orchestrator", "schemas", "tests", "workers", "perfbound")
    ]
    folders += [
        path for folder in folders for path in folder.rglob("*") if path.is_dir() and "fixtures" not in path.parts
    ]
    numbers = {folder: sum(each.is_file() and each.suffix != ".pyc" for each in folder.iterdir()) for folder in folders}
    assert {folder: number for folder, number in numbers.items() if number > FILES} == {}


def test_a_small_module_has_several_importers_or_says_why_it_is_apart() -> None:
    importers = defaultdict(set)
    for one, other in source.arrows(everywhere=True):
        importers[other].add(one)
    for module, others in importers.items():
        if source.lines(module) >= SMALL or len(others) > 1 or module.endswith(("__init__.py", "__main__.py")):
            continue
        if module.startswith("perfbound/"):  # its package hands every name on
            continue
        beside = [other for other in others if Path(other).parent == Path(module).parent and "__init__" not in other]
        said = ast.get_docstring(source.modules()[module]) or ""
        # A formula with its table of symbols is an idea of its own.
        assert not beside or "| symbol |" in said or "apart" in said.split("\n\n")[0], (module, beside)


def test_modules_are_short() -> None:
    assert {name for name in source.modules() if source.lines(name) > MODULE_LINES} == set(LARGE_MODULES)


def test_classes_are_small() -> None:
    large = {each.name for each in source.classes() if each.lines > CLASS_LINES or each.methods > METHODS}
    assert large == set(LARGE_CLASSES)


def test_functions_have_few_parameters() -> None:
    assert {name for name, number in source.parameters() if number > PARAMETERS} == set(MANY_PARAMETERS)


def test_arrows_between_rooms_are_few_and_lead_down() -> None:
    arrows = {(one, other) for one, other in source.arrows_of_rooms() if one in ROOMS}
    assert {other for _, other in arrows} <= FLOORS.keys()
    assert [(one, other) for one, other in arrows if FLOORS[other] >= FLOORS[one]] == []
    assert len(arrows) <= ARROWS, sorted(arrows)


def test_no_module_imports_itself_by_a_detour() -> None:
    imported = defaultdict(set)
    for one, other in source.arrows(everywhere=False):
        imported[one].add(other)
    list(graphlib.TopologicalSorter(imported).static_order())


@pytest.mark.rest
def test_no_unit_test_imports_the_benchmarks() -> None:
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        imports = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        assert not [each.module for each in imports if (each.module or "").startswith("tests.studies.benchmarks")], path

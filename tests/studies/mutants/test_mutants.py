"""The parts of the mutation test that run nothing: places, stages, what was judged, and what is counted."""

from pathlib import Path
from textwrap import dedent

import pytest

from tests.studies.mutants.places import Position, Span, left_out
from tests.studies.mutants.results import (
    EQUIVALENT,
    Equivalent,
    Judgement,
    Mutant,
    append,
    equivalents,
    is_equivalent,
    judgements,
    line,
    share,
)
from tests.studies.mutants.stages import stages

ROOT = Path(__file__).parents[3]
MUTANTS = [Mutant("schemas/ids.py", number, "a < b", f"a <= {number}", f"text {number}") for number in range(4)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def f(x: int | None) -> int | None: return 1 | 2", ["int | None", "int | None"]),
        ("Event = Up | Down\nLIMIT = A | B", ["Up | Down"]),
        ("if TYPE_CHECKING:\n    x = 1", ["if TYPE_CHECKING:\n    x = 1"]),
        ("@functools.lru_cache(maxsize=2)\n@wraps(g)\ndef f(): ...", ["functools.lru_cache(maxsize=2)"]),
        ("@dataclass(frozen=True, order=True)\nclass A: ...", ["True"]),
        ("'é'; zip(a, b, strict=True)", ["True"]),
        ("__all__ = ['a'] + B", ["['a'] + B"]),
        ("x = 1  # pragma: no cover\ny = 2", ["x = 1  # pragma: no cover\n"]),
    ],
)
def test_no_mutant_is_made_of_what_only_mypy_or_ruff_checks(source: str, expected: list[str]) -> None:
    assert sorted(_text(source, span) for span in left_out(source)) == sorted(expected)


def _text(source: str, span: Span) -> str:
    lines = source.splitlines(keepends=True)
    before = [sum(map(len, lines[: each.line - 1])) + each.column for each in (span.start, span.stop)]
    return source[before[0] : before[1]]


def test_a_span_covers_what_lies_in_it() -> None:
    outer = Span(Position(1, 4), Position(3, 0))
    assert outer.covers(Span(Position(1, 4), Position(2, 80)))
    assert not outer.covers(Span(Position(1, 3), Position(1, 5)))
    assert not outer.covers(Span(Position(2, 0), Position(3, 1)))


def test_a_mutant_meets_its_folder_then_the_other_unit_tests_then_the_rest() -> None:
    first, second, third = stages("orchestrator/store/rows.py", ROOT)
    unit = {str(path.relative_to(ROOT)) for path in (ROOT / "tests" / "unit").rglob("test_*.py")}
    assert {str(Path(each).parent) for each in first.arguments} == {"tests/unit/store"}
    assert {*first.arguments, *second.arguments} == unit
    assert not {*first.arguments}.intersection(second.arguments)
    assert third.arguments == ("tests", "--ignore=tests/unit")
    assert [each.usual[0] for each in (first, second, third)] == ["tests/unit/store", "tests/unit", "tests"]


def test_files_that_import_the_module_come_first_then_those_of_the_rooms_above() -> None:
    first, second, _ = stages("orchestrator/store/lock.py", ROOT)
    importing = [".lock import" in (ROOT / each).read_text() for each in first.arguments]
    assert importing == sorted(importing, reverse=True)
    assert sum(importing) in range(1, len(importing))
    others = [each for each in second.arguments if ".lock import" not in (ROOT / each).read_text()]
    rooms = list(dict.fromkeys(each.split("/")[2] for each in others))
    places = [rooms.index(room) for room in ("campaign", "run", "cli", "schemas")]
    assert places == sorted(places)


@pytest.mark.parametrize(
    ("path", "home"),
    [
        ("schemas/file/space.py", "tests/unit/schemas/file"),
        ("workers/systems/running.py", "tests/unit/workers/systems"),
        ("workers/guardian.py", "tests/unit/workers"),
        ("perfbound/library/rig.py", "tests/unit/library"),
        ("orchestrator/certificate/verify/attempts.py", "tests/unit/certificate"),
    ],
)
def test_the_unit_tests_of_a_module_mirror_its_folder(path: str, home: str) -> None:
    assert stages(path, ROOT)[0].usual == (home,)


def test_a_module_without_a_folder_of_tests_begins_with_all_unit_tests() -> None:
    assert [each.number for each in stages("orchestrator/__main__.py", ROOT)] == [2, 3]


def test_results_continue_after_a_kill_and_survivors_are_judged_again_after_a_change(tmp_path: Path) -> None:
    path = tmp_path / "new" / "results.jsonl"
    caught = Judgement("a", 1, "caught", "tests/x.py::test_y", 2.0, "old")
    survived = Judgement("b", 1, "survived", "", 2.0, "old")
    append(path, caught)
    with path.open("a") as file:
        file.write('{"mutant": "c", "sta')
    append(path, survived)
    assert judgements(path, "old") == {"a": [caught], "b": [survived]}
    assert judgements(path, "new") == {"a": [caught]}
    assert judgements(tmp_path / "none", "new") == {}


def test_the_share_counts_those_that_met_the_last_stage_or_were_caught() -> None:
    keys = [each.key for each in MUTANTS]
    assert len(set(keys)) == len(keys)
    found = {
        keys[0]: [Judgement(keys[0], 1, "survived", "", 1, ""), Judgement(keys[0], 2, "caught", "t", 3, "")],
        keys[1]: [Judgement(keys[1], 1, "timed out", "", 99, "")],
        keys[2]: [Judgement(keys[2], 1, "survived", "", 1, "")],
    }
    assert share(MUTANTS, found, 1) == "caught: 1 of 4; 1 in stage 1, 1 not judged yet"
    assert share(MUTANTS, found, 2) == "caught: 2 of 4; 1 in stage 1, 1 in stage 2, 2 not judged yet"
    assert share(MUTANTS[:2], found, 2) == "caught: 2 of 2 (100 %); 1 in stage 1, 1 in stage 2"
    assert share([], {}, 3) == "caught: 0 of 0"
    lines = [line(each, found.get(each.key, []), 1) for each in MUTANTS[1:]]
    assert lines[0] == "schemas/ids.py:1: a < b  ->  a <= 1: timed out in stage 1 (99 s)"
    assert lines[1].endswith(": SURVIVED, up to stage 1")
    assert lines[2].endswith(": not judged yet")
    assert line(MUTANTS[0], found[keys[0]], 3).endswith(": caught in stage 2 by t (3 s)")


def test_a_listed_mutant_is_still_in_the_code_and_has_a_reason(tmp_path: Path) -> None:
    for each in equivalents(EQUIVALENT):
        lines = [one.strip() for one in (ROOT / each.file).read_text().splitlines()]
        assert each.was in lines, f"{each.file}: no line is {each.was}"
        assert each.reason
    path = tmp_path / "equivalent.toml"
    text = """
        [[equivalent]]
        file = "schemas/ids.py"
        was = "a < b"
        becomes = "a <= 2"
        reason = "They differ."
    """
    path.write_text(dedent(text))
    assert equivalents(path) == [Equivalent("schemas/ids.py", "a < b", "a <= 2", "They differ.")]
    assert [is_equivalent(each, equivalents(path)) for each in MUTANTS] == [False, False, True, False]

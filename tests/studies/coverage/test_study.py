"""The study's own parts: what it may import, what it takes for true, and that a kill or a worker changes no number."""

import ast
import doctest
import json
import math
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scipy.stats import binom
from sklearn.gaussian_process.kernels import Matern

from tests.studies.coverage import bounded, functions, laws, noises, oracle, page, records, run, spot_page, summary
from tests.studies.coverage.controls import disturbed
from tests.studies.coverage.controls.campaigns import Bounds, Controls
from tests.studies.coverage.controls.wrong_laws import DeclaredLaw
from tests.studies.coverage.kriging import Kriging
from tests.studies.coverage.records import Row
from tests.studies.coverage.regions import Region
from tests.studies.coverage.requirements import Requirements
from tests.studies.coverage.rigorous import Audit
from tests.studies.coverage.scenario import Scenario
from tests.studies.coverage.study import CHUNK, all_rows, one_chunk
from tests.studies.pages import PageError

PURE = (functions, noises, bounded, laws, disturbed, oracle)
ALLOWED = {"numpy", "scipy", "sklearn"} | set(sys.stdlib_module_names)


@pytest.mark.parametrize("module", PURE, ids=lambda module: module.__name__)
def test_what_is_taken_for_true_knows_nothing_of_ours(module: object) -> None:
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))  # type: ignore[attr-defined]
    nodes = list(ast.walk(tree))
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "." for node in nodes if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in imported} <= ALLOWED


def test_importing_it_loads_nothing_of_ours() -> None:
    names = ", ".join(module.__name__ for module in PURE)
    program = f"import sys, {names}; print([m for m in sys.modules if m.split('.')[0] in ('orchestrator', 'workers')])"
    found = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=records.ROOT
    )
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("nu", [0.5, 1.5, 2.5])
def test_the_norm_is_exact(dimension: int, nu: float) -> None:
    """By its definition; and by interpolation at the centres, whose norm is the same without using the weights."""
    rng = np.random.default_rng(5)
    for _ in range(8):
        f = functions.random_function(rng, dimension, nu=nu, length_scale=1.5, norm=0.7)
        assert math.isclose(f.norm, 0.7, rel_tol=1e-12)
        values, matrix = f(f.centres), Matern(1.5, nu=nu)(f.centres)
        assert math.isclose(math.sqrt(values @ np.linalg.solve(matrix, values)), 0.7, rel_tol=1e-6)


def test_the_maximum_is_found() -> None:
    """A single centre with weight B has its maximum B there; the grid alone would miss it."""
    f = functions.Known(Matern(1.5, nu=2.5), np.array([[2.34, 1.23]]), np.array([0.7]))
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    assert f(grid).max() < 0.69
    assert math.isclose(functions.maximum(f, grid), 0.7, rel_tol=1e-6)


@pytest.mark.parametrize("name", noises.NOISES)
def test_noise_is_centred_and_sub_gaussian(name: str) -> None:
    """E exp(t xi) <= exp(t^2 R^2 / 2) for draws that are independent of the past, up to the error of the estimate."""
    rng, scale = np.random.default_rng(1), 0.3
    draws = np.array([noises.NOISES[name](rng, scale, 1, ()) for _ in range(20_000)])
    assert abs(draws.mean()) < 4 * scale / math.sqrt(len(draws))
    for t in (-2.0 / scale, -0.5 / scale, 0.5 / scale, 2.0 / scale):
        powers = np.exp(t * draws)
        assert powers.mean() <= math.exp(t * t * scale * scale / 2) + 4 * powers.std() / math.sqrt(len(draws))


@pytest.mark.parametrize("errors", [0.0, 1.0])
@pytest.mark.parametrize("mean", [0.6, 0.72, 0.9])
@pytest.mark.parametrize("name", bounded.BOUNDED)
def test_bounded_rollouts_are_in_the_range_and_have_their_mean(name: str, mean: float, errors: float) -> None:
    draws = bounded.BOUNDED[name](np.random.default_rng(4), mean, errors, 20_000)
    assert draws.min() >= 0.0
    assert draws.max() <= 1.0
    assert abs(draws.mean() - mean) < 5 * draws.std() / math.sqrt(len(draws))


@pytest.mark.parametrize("law", [law for pair in laws.LAWS.values() for law in pair])
def test_moments_of_a_law_are_those_of_its_draws(law: laws.Law) -> None:
    draws = law.draw(np.random.default_rng(2), 20_000)
    assert math.isclose(law.weights.sum(), 1.0, rel_tol=1e-9)
    assert abs(draws.mean() - law.mean) < 5 * draws.std() / math.sqrt(len(draws))
    assert law.linearised <= law.mean - laws.RISK_WEIGHT * math.sqrt(law.weights @ (law.atoms - law.mean) ** 2) + 1e-12


@pytest.mark.parametrize("name", disturbed.DISTURBED)
def test_disturbed_rollouts_are_in_the_range_and_have_their_moments(name: str) -> None:
    rng, law = np.random.default_rng(6), disturbed.DISTURBED[name]
    for side in (1, -1):
        draws = law.value(disturbed.draw(rng, 20_000), rng, side)
        assert draws.min() >= 0.0
        assert draws.max() <= 1.0
        assert abs(draws.mean() - disturbed.MEAN) < 5 * draws.std() / math.sqrt(len(draws))
        assert abs(draws.std() / law.law.std() - 1) < 0.05
    assert abs(law.law.mean() - disturbed.MEAN) < 1e-6


def test_the_extreme_law_has_the_risk_that_is_taken_for_true() -> None:
    draws = laws.draw_extremes(np.random.default_rng(3), 0.5, 50_000)
    assert set(draws) == set(laws.CLIP)
    assert abs(draws.mean() - laws.RISK_WEIGHT * draws.std() - float(laws.extreme_risk(0.5))) < 0.01


def test_the_rule_has_the_level_that_it_names() -> None:
    limit = oracle.allowed(1000, 0.1)
    assert binom.sf(limit, 1000, 0.1) <= oracle.LEVEL < binom.sf(limit - 1, 1000, 0.1)


def test_not_a_number_is_outside() -> None:
    zero, one = np.zeros(1), np.ones(1)
    assert oracle.outside(np.array([math.nan]), zero, one)
    assert oracle.outside(np.array([0.5]), zero, np.array([math.nan]))
    assert not oracle.outside(np.array([1.0]), zero, one)
    assert oracle.outside(np.array([1.0 + 1e-8]), zero, one)


def test_the_doctests_hold() -> None:
    for module in (oracle, summary):
        found = doctest.testmod(module)
        assert (found.failed, found.attempted > 0) == (0, True)


def test_the_design_has_every_level() -> None:
    rows: list[Row] = all_rows()
    assert len({records.digest(row) for row in rows}) == len(rows)
    rigorous = [row for row in rows if row.kind == "rigorous"]
    for name, levels in {
        "place": {"box", "list"},
        "dimension": {1, 2, 3},
        "nu": {0.5, 1.5, 2.5},
        "noise": set(noises.NOISES),
        "window": {1, 8},
    }.items():
        assert {getattr(row, name) for row in rigorous} == levels
    assert {getattr(row, "size") for row in rows if row.kind == "scenario"} == {1, 4, 25}  # noqa: B009  (of its kind)
    several = [row for row in rows if isinstance(row, Requirements)]
    assert {(row.method, row.law) for row in several} == {
        *(("scenario", law) for law in laws.LAWS),
        *(("rigorous", noise) for noise in noises.NOISES),
    }
    assert {(row.method, row.worst) for row in several} == {
        *(("scenario", worst) for worst in ("apart", "same")),
        *(("rigorous", worst) for worst in ("apart", "same", "flat")),
    }
    weighted = [row for row in rows if type(row) is Kriging]
    assert {row.noise for row in weighted} == set(bounded.BOUNDED)
    assert {(row.flat, row.order) for row in weighted} == set(product((False, True), ("planned", "where lowest")))
    controlled = {(row.bounds, row.disturbances) for row in rows if type(row) is Controls}
    assert controlled == set(product(get_args(Bounds), disturbed.DISTURBED))
    declared = {(row.bounds, row.law_scale, row.rollouts) for row in rows if isinstance(row, DeclaredLaw)}
    assert declared == set(product(("kriging", "mean"), (0.9, 1.0, 1.1), (512, 1024, 2048, 4096)))
    assert {(row.dimension, row.flat) for row in rows if isinstance(row, Region)} == {
        (1, True),
        (1, False),
        (2, False),
        (3, False),
    }


ROWS: list[Row] = [Scenario(size=1, tests=2), Audit(small_b=8.0, tests=2)]


def test_workers_and_a_kill_change_no_number(tmp_path: Path) -> None:
    alone, shared = tmp_path / "alone", tmp_path / "shared"
    run.run(ROWS, 2 * CHUNK, 1, alone)
    run.run(ROWS[:1], CHUNK, 1, shared)
    file = records.path(ROWS[0], shared)
    cut = json.dumps({"chunk": 1, "results": {}})[:-9]
    file.write_text(file.read_text(encoding="utf-8") + cut, encoding="utf-8")
    assert len(run.missing(ROWS, 2, shared)) == 3
    run.run(ROWS, 2 * CHUNK, 2, shared)
    assert run.missing(ROWS, 2, shared) == []
    for row in ROWS:
        assert records.read(row, shared) == records.read(row, alone)


def test_campaigns_of_a_row_differ_and_repeat() -> None:
    assert one_chunk(ROWS[1], 0) == one_chunk(ROWS[1], 0) != one_chunk(ROWS[1], 1)


def test_comments_are_not_code() -> None:
    bare = records._bare
    assert bare('def f():\n    """Say."""\n    return 1  # why\n') == bare('def f():\n    """Else."""\n    return 1\n')
    assert bare("x = 1") != bare("x = 2")


def found_row(small_b: float, *, refuted: int) -> page.Found:
    names = ("bound", "unnoticed", "spread", "tests")
    return page.Found(
        Audit(small_b), {"refuted": [1.0] * refuted + [0.0] * (50 - refuted), **dict.fromkeys(names, [0.0] * 50)}
    )


def test_the_verdict_is_about_right_premises_only() -> None:
    limit = oracle.allowed(50, 0.1)
    assert not found_row(1.0, refuted=limit).fails
    assert found_row(1.0, refuted=limit + 1).fails
    assert not found_row(2.0, refuted=50).fails


def test_the_page_is_written_between_its_marks(tmp_path: Path) -> None:
    results = tmp_path / "results"
    shutil.copytree(summary.RESULTS, results)
    target = tmp_path / "page.md"
    parts = "\n".join(f"{begin}\nreplaced text\n{end}" for begin, end in map(summary.marks, summary.PARTS))
    target.write_text(f"before\n{parts}\nafter\n", encoding="utf-8")
    page.write(target, [found_row(1.0, refuted=50), found_row(2.0, refuted=10)], results)
    text = target.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "replaced text" not in text
    assert "**FAILS**" in text
    assert (tmp_path / summary.FIGURE).stat().st_size < 100_000
    assert len(summary.read("audit", results)) == 2
    assert summary.read("paper", results) == summary.read("paper"), "a kind without results keeps its record"
    origins = {line["kind"]: line["code"] for line in summary.read("origins", results)}
    assert origins["audit"] == records.code("audit")
    assert set(origins) == set(page.TABLES)


def test_the_page_has_what_the_generator_writes_from_the_records() -> None:
    text = (records.ROOT / "docs" / "coverage.md").read_text(encoding="utf-8")
    assert all(summary.part(name) in text for name in summary.PARTS)


def test_the_page_has_what_the_record_of_silent_claims_says() -> None:
    text = spot_page.RECORD.read_text(encoding="utf-8")
    record = json.loads(text)
    assert spot_page.section(record) in (records.ROOT / "docs" / "coverage.md").read_text(encoding="utf-8")
    assert spot_page.record_text(record) == text
    assert {each["campaigns"] for each in record["claims"]} == {record["functions"]}


def test_every_kind_has_a_record_with_the_columns_of_its_table() -> None:
    assert set(page.TABLES) == set(page.JUDGED) == {row.kind for row in all_rows()}
    assert {line["kind"] for line in summary.read("origins")} == set(page.TABLES)
    for kind, (_, columns) in page.TABLES.items():
        lines = summary.read(kind)
        assert list(lines[0]) == [title for title, _ in columns]
        assert len(lines) == sum(row.kind == kind for row in all_rows())


def test_a_row_that_fails_is_not_hidden_among_others(tmp_path: Path) -> None:
    results = tmp_path / "results"
    shutil.copytree(summary.RESULTS, results)
    lines = summary.read("rigorous")
    lines[0] |= {"any": "999", "verdict": "**FAILS**"}
    (results / "rigorous.csv").write_text(summary.csv_text(lines), encoding="utf-8")
    (bad,) = [line for line in summary.part("claims", results).splitlines() if "FAILS" in line]
    assert "| 999/137 |" in bad


def test_a_missing_record_is_named(tmp_path: Path) -> None:
    with pytest.raises(summary.RecordError, match="no record of paper"):
        summary.part("contrast", tmp_path)


@pytest.mark.parametrize("text", [None, "no marks"])
def test_a_page_that_cannot_be_written_is_named(tmp_path: Path, text: str | None) -> None:
    target = tmp_path / "page.md"
    if text is not None:
        target.write_text(text, encoding="utf-8")
    with pytest.raises(PageError, match=r"page\.md"):
        page.write(target, [found_row(1.0, refuted=0)], tmp_path / "results")
    assert not (tmp_path / "results").exists()

"""What the report data have of rollouts: ranks, violations by starts, robustness over time, and a bounded size."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.report.collect import scenes
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.data.page import ReportData
from perfbound.orchestrator.report.data.rollouts import Curve, DrawnRollout, RolloutsOfTest
from perfbound.orchestrator.report.rollout import curves, over_time
from perfbound.orchestrator.store.export import table_rows
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import RolloutFact
from perfbound.schemas.system import AfterEnd
from perfbound.schemas.trajectory.trajectory import Trajectory
from tests.fakes.finished import a_list, a_pair, finish, play

CONFIGS = {"gap": a_pair("rigorous"), "list": a_list()}


@pytest.fixture(scope="module", params=CONFIGS)
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, no_disk: None) -> Path:
    """Return the directory of a finished campaign; tests leave it as it is."""
    directory = tmp_path_factory.mktemp(request.param)
    finish(play(directory, CONFIGS[request.param]), directory)
    return directory


@pytest.fixture(scope="module")
def data(finished: Path) -> ReportData:
    return Collector(finished).refresh()


def recorded(directory: Path) -> list[dict[str, object]]:
    """Return the table of rollouts."""
    columns, rows = table_rows(directory, "rollouts")
    return [dict(zip([column.name for column in columns], row, strict=True)) for row in rows]


# Ranks and starts


def test_the_first_test_has_the_worst_rollout_of_the_tested_variant(finished: Path, data: ReportData) -> None:
    values = sorted(float(str(row["robustness"])) for row in recorded(finished) if row["variant"] == "true")
    found = {each.rank: each for each in data.ranked}
    assert list(found) == ["worst", "first violation", "median", "best"]
    assert {each.of for each in data.ranked} == {len(values)}
    assert (found["worst"].robustness, found["best"].robustness) == (values[0], values[-1])
    assert found["median"].robustness == values[(len(values) - 1) // 2]
    assert found["first violation"].robustness < 0
    for each in data.ranked:
        scene = next(scene for scene in data.scenes if (scene.problem, scene.test) == (each.problem, each.test))
        assert each.rollout in {drawn.id for drawn in scene.drawn}, "it has curves, whatever its robustness"


def test_every_violation_belongs_to_one_start(finished: Path, data: ReportData) -> None:
    assert data.violating is not None
    starts = [start for group in data.violating.groups for start in group.starts]
    assert sum(start.violations for start in starts) == data.violations > 0
    assert {start.x for start in starts} == {rollout.x for rollout in data.counterexamples}
    names = list(Collector(finished).refresh().axes)
    rows = recorded(finished)
    for start in starts:
        here = [
            float(str(row["robustness"]))
            for row in rows
            if tuple(row[axis.name] for axis in names) == pytest.approx(start.x)
        ]
        assert start.rollouts == len(here)
        assert start.violations == sum(value < 0 for value in here)
        assert start.worst == min(here)
    assert min(start.worst for start in starts) == data.violating.groups[0].worst


def test_a_campaign_without_violations_has_no_groups(tmp_path: Path, no_disk: None) -> None:
    config = a_list().model_copy(update={"specification": "always (value >= -100)"})
    finish(play(tmp_path, config), tmp_path)
    found = Collector(tmp_path).refresh()
    assert (found.violations, found.violating) == (0, None)
    assert [each.rank for each in found.ranked] == ["worst", "median", "best"]


# Robustness over time


def test_the_robustness_of_each_curve_is_a_value_of_its_signal(data: ReportData) -> None:
    low, high = data.clip or (-np.inf, np.inf)
    for scene in data.scenes:
        assert scene.margin_of
        pick = {"least": min, "greatest": max, "first": lambda values: values[0]}[scene.attained]
        for drawn in scene.drawn:
            value = float(pick(drawn.margin))  # type: ignore[operator]
            assert drawn.robustness == pytest.approx(min(max(value, low), high), abs=1e-9)
        assert {curve.rollout for curve in scene.traces} == {drawn.id for drawn in scene.drawn}


def described(formula: str, values: list[float]) -> DrawnRollout:
    t = np.arange(float(len(values)))
    trajectory = Trajectory(("t", "x"), np.column_stack([t, values]))
    fact = RolloutFact(RolloutId("true_risk", 0, "true", 0), 7, "", 0, "", -1.0)
    return over_time.with_margin(fact, trajectory, parse_formula(formula))


def test_the_worst_moment_is_a_stretch_of_time_or_nothing() -> None:
    assert described("always x >= 2", [5, 1, 3]).moment == (1.0, 1.0)
    assert described("always x >= 2", [5, 1, 1, 1]).moment == (1.0, 3.0)
    assert described("always x >= 2", [5, 1, 3, 1]).moment is None
    assert described("always x >= 2", [5, 1, 3]).columns == ("x",)
    assert set(described("always x - t >= 2", [5, 1, 8]).columns) == {"t", "x", "x - t"}


@pytest.mark.parametrize("after_end", ["hold", "fail"])
def test_of_a_rollout_that_ends_early_and_fails_its_end_decides(after_end: AfterEnd) -> None:
    samples = np.array([[0.0, 5.0, 0.0], [1.0, 1.0, 0.0], [2.0, 4.0, 0.0], [4.0, 4.0, 1.0]])
    fact = RolloutFact(RolloutId("true_risk", 0, "true", 0), 7, "", 0, "", -0.5, ended=2.0)
    trajectory = Trajectory(("t", "x", "ended"), samples)
    found = over_time.with_margin(fact, trajectory, parse_formula("always x >= 0"), after_end)
    assert (found.failed_at, found.moment, found.columns) == (
        (2.0, (2.0, 2.0), ("ended",)) if after_end == "fail" else (None, (1.0, 1.0), ("x",))
    )


def test_a_signal_begins_and_ends_with_what_is_read() -> None:
    found = described("always[1,2] x >= 2", [0, 5, 1, 0])
    assert (found.t, found.margin) == ((1.0, 2.0), (3.0, -1.0))
    assert over_time.shown_formula(parse_formula("always[1,2] x >= 2")) == ("x >= 2", "least")
    assert over_time.shown_formula(parse_formula("x >= 2 until x >= 3")) == ("x >= 2 until x >= 3", "first")
    assert over_time.shown_formula(None) == ("", "")


def test_the_worst_sample_of_a_long_rollout_is_kept() -> None:
    values = [5.0] * 2000
    values[1234] = -3.0
    found = described("always x >= 2", values)
    assert len(found.t) <= curves.MOST_POINTS
    assert (found.moment, min(found.margin)) == ((1234.0, 1234.0), -5.0)


# Further columns, and the size of a report


def test_every_recorded_column_is_shown_or_offered(finished: Path, data: ReportData) -> None:
    for scene in data.scenes:
        shown = {curve.column for curve in scene.traces}
        assert shown.isdisjoint(scene.further_columns)
        assert {curve.column for curve in scene.further} == set(scene.further_columns)


def scene(test: int, points: int, further: int) -> RolloutsOfTest:
    curve = Curve("", "true", "x", "m", tuple(map(float, range(points))), (0.0,) * points)
    more = Curve("", "true", "y", "m", tuple(map(float, range(further))), (0.0,) * further)
    return RolloutsOfTest("true_risk", test, (curve,), (), (), further=(more,), further_columns=("y",))


def test_a_report_has_room_for_some_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "MOST_NUMBERS", 100)
    monkeypatch.setattr(scenes, "MOST_FURTHER_NUMBERS", 40)
    found = scenes.bounded_scenes(scene(test, 20, 15) for test in range(9))
    assert [each.test for each in found] == [0, 1], "80 numbers, and a third scene had 120"
    assert [bool(each.further) for each in found] == [True, False], "30 numbers, and then 60"
    assert found[1].further_columns == ("y",), "it is still offered, by the live page"
    assert [each.test for each in scenes.bounded_scenes([scene(0, 500, 0)])] == [0], "one is always there"


def test_a_live_page_gets_further_columns_on_request(finished: Path, data: ReportData) -> None:
    sent = scenes.without_further(data.scenes)
    assert all(each.further == () for each in sent)
    first = data.scenes[0]
    asked = Collector(finished).rollouts_of_test(first.problem, first.test)
    assert asked == replace(first, further=asked.further)
    assert {curve.column for curve in asked.further} == set(first.further_columns)

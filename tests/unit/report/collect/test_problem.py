"""The data of the charts: requirement and clip, importance, prediction at fresh starts, robustness of all rollouts."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.report.collect import importance, limits, prediction
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.collect.complete import RolloutValues
from perfbound.orchestrator.report.collect.posterior import posterior
from perfbound.orchestrator.report.data.bars import bar_counts, edges
from perfbound.orchestrator.report.data.page import Problem, to_json
from perfbound.orchestrator.store.rollout_values import AddedValues
from perfbound.workers.systems import load_system
from tests.fakes.finished import a_list, a_pair, finish, play

CONFIGS = {
    "paper": a_pair("paper", spot_check=12),
    "rigorous": a_pair("rigorous", spot_check=12, spot_check_followups=4),
    "scenario": a_list(),
}
TEST_FUNCTION = load_system("test-function").spec


@pytest.fixture(scope="module", params=CONFIGS)
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, no_disk: None) -> Path:
    """Return the directory of a finished campaign."""
    directory = tmp_path_factory.mktemp(request.param)
    finish(play(directory, CONFIGS[request.param]), directory)
    return directory


def problems(directory: Path) -> dict[str, Problem]:
    return {each.name: each for each in Collector(directory).refresh().problems}


def recorded(directory: Path, query: str) -> list[tuple[float, ...]]:
    with closing(sqlite3.connect(directory / "campaign.db")) as connection:
        return list(connection.execute(query))


def test_every_rollout_is_in_the_histogram_of_its_problem(finished: Path) -> None:
    for name, problem in problems(finished).items():
        found = problem.charts.rollouts
        assert found is not None
        for each in found.variants:
            query = f"SELECT robustness, test FROM rollouts WHERE problem = '{name}' AND variant = '{each.variant}'"
            rows = recorded(finished, query)
            values = [value for value, _ in rows]
            assert sum(each.counts) == each.rollouts == len(values)
            assert each.violations == sum(value < 0 for value in values)
            assert (each.least, each.test) == min(rows)
            assert found.edges[0] <= min(values)
            assert max(values) <= found.edges[-1]


def test_prediction_and_observation_of_each_fresh_start(finished: Path) -> None:
    """Counted anew from the database, at the bounds that `perfbound.results` has."""
    for name, problem in problems(finished).items():
        found = problem.charts.prediction
        if problem.surfaces[0].shape is None:
            assert found is None  # listed starts have no spot check
            continue
        assert found is not None
        assert len(found.observed) == found.starts
        assert found.inside == found.starts - sum(found.outside)
        for y, low, high, outside in zip(found.observed, found.lower, found.upper, found.outside, strict=True):
            assert y is not None
            beyond = (low is not None and y < low) or (high is not None and y > high)
            assert beyond == outside
        if problem.method == "rigorous":
            rows = recorded(finished, "SELECT x FROM tests WHERE problem = 'spot_check' ORDER BY test")
            x = np.array([[float(v) for v in str(row[0]).strip("[]").split(",")] for row in rows])[: found.starts]
            _, lower, upper = posterior(finished, name, x)
            assert found.lower == pytest.approx(tuple(lower))
            assert found.upper == pytest.approx(tuple(upper))


def test_of_very_many_starts_those_outside_are_kept() -> None:
    outside = np.zeros(20_000, dtype=np.bool_)
    outside[[3, 777, 19_999]] = True
    kept = prediction._kept_starts(outside)
    assert len(kept) == prediction.MOST_POINTS
    assert {3, 777, 19_999} <= set(kept.tolist())
    everywhere = prediction._kept_starts(np.ones(20_000, dtype=np.bool_))
    assert 0 < len(everywhere) <= prediction.MOST_POINTS


def test_the_mean_is_cut_at_what_an_observation_can_be() -> None:
    plan = next(each for each in plans(CONFIGS["rigorous"], TEST_FUNCTION).values() if each.sense == "min")
    low, high = limits.ends(plan)
    assert (low, high) == plan.clip
    assert low is not None
    assert high is not None
    beyond = np.array([-high - 1.0, -high, -(low + high) / 2, -low, -low + 1.0])
    assert limits.within(beyond, plan).tolist() == [-high, -high, -(low + high) / 2, -low, -low]


def test_the_page_has_no_mean_beyond_the_clip(finished: Path) -> None:
    for problem in problems(finished).values():
        low, high = problem.charts.clip
        for surface in problem.surfaces:
            for mean in surface.mean:
                assert mean is None or low is None or mean >= low
                assert mean is None or high is None or mean <= high


@pytest.mark.parametrize(("margin", "limit"), [(0.0, None), (0.3, None), (0.0, 0.2)])
def test_a_requirement_is_that_of_the_first_claim_alone(margin: float, limit: float | None) -> None:
    """The claim of a pair is composed, so that it is about neither of its problems."""
    composed = CONFIGS["rigorous"].model_copy(update={"required_margin": margin, "required_at_most": limit})
    for plan in plans(composed, TEST_FUNCTION).values():
        assert limits.required(composed, plan) is None
    listed = CONFIGS["scenario"].model_copy(update={"required_margin": margin, "required_at_most": limit})
    (plan,) = plans(listed, TEST_FUNCTION).values()
    assert limits.required(listed, plan) == margin
    assert limits.is_robustness(plan)


def test_the_importance_of_a_mean_over_a_lattice() -> None:
    plan = next(iter(plans(CONFIGS["rigorous"], TEST_FUNCTION).values()))
    lattice = Lattice((0.0, -1.0, 0.0), (1.0, 1.0, 2.0), 5)
    found = importance.of_model(replace(plan, candidates=lattice), lattice.nodes @ np.array([0.1, 2.0, 0.0]))
    assert found is not None
    assert found.of_model
    assert found.chance is None
    assert [each.axis for each in found.parameters] == [1, 0, 2]
    most = found.parameters[0]
    assert most.first == pytest.approx(4.0 / (4.0 + 0.0025))
    assert most.total == pytest.approx(most.first)
    assert most.at == pytest.approx((-1.0, -0.5, 0.0, 0.5, 1.0))
    assert np.diff(most.effect) == pytest.approx([1.0] * 4)


def test_a_model_without_variation_or_with_gaps_has_no_importance() -> None:
    plan = next(iter(plans(CONFIGS["rigorous"], TEST_FUNCTION).values()))
    flat = replace(plan, candidates=Lattice((0.0, 0.0), (1.0, 1.0), 3))
    assert importance.of_model(flat, np.ones(9)) is None
    assert importance.of_model(flat, np.array([np.nan, *range(8)])) is None


def test_few_tests_say_nothing_about_importance() -> None:
    x = np.random.default_rng(2).uniform(size=(200, 3))
    y = x[:, 2]
    assert importance.of_drawn_tests(x[:49], y[:49]) is None
    found = importance.of_drawn_tests(x, y)
    assert found is not None
    assert found.chance is not None
    assert found.parameters[0].axis == 2
    assert found.parameters[0].total is None
    assert all(each.first <= 2 * found.chance for each in found.parameters[1:])
    among = importance.of_drawn_tests(x, y, read=[0, 2])
    assert among is not None
    assert [(each.axis, each.first) for each in among.parameters] == [
        (each.axis, each.first) for each in found.parameters if each.axis != 1
    ]
    assert importance.of_drawn_tests(x, y, read=[2]) is None


def test_a_histogram_tells_its_variants_and_the_clip() -> None:
    values = RolloutValues()
    rows = [("p", "true", [0, 1], [-2.0, -2.0]), ("p", "true", [2], [0.0]), ("p", "nominal", [2], [3.0])]
    values.add(
        AddedValues(*row[:2], np.array(row[2]), np.zeros(len(row[2]), dtype=np.int64), np.array(row[3]))
        for row in [*rows, ("q", "true", [0], [9.0])]
    )
    found = values.histogram("p", (-2.0, 3.0), "m")
    assert found is not None
    nominal, true = found.variants
    assert (nominal.rollouts, nominal.violations, nominal.at_clip) == (1, 0, (0, 1))
    assert (true.rollouts, true.violations, true.least, true.test, true.at_clip) == (3, 2, -2.0, 0, (2, 0))
    assert 0.0 in found.edges
    assert sum(true.counts[: found.edges.index(0.0)]) == 2  # 0 itself is no violation
    assert values.histogram("r", None, "m") is None


def test_bars_end_at_their_edges() -> None:
    ends = edges(-0.35, 0.95)
    assert 0.0 in ends
    assert bar_counts([ends[0], 0.0, ends[-1]], ends)[ends.index(0.0)] == 1
    assert sum(bar_counts([ends[0] - 1, ends[-1] + 1], ends)) == 2


@pytest.mark.rest
@pytest.mark.integration
def test_a_hundred_thousand_rollouts_fit_in_the_page(tmp_path: Path, no_disk: None) -> None:
    finish(play(tmp_path, CONFIGS["rigorous"]), tmp_path)
    values = RolloutValues()
    y = np.random.default_rng(4).normal(size=100_000)
    values.add([AddedValues("p", "true", np.arange(100_000), np.zeros(100_000, dtype=np.int64), y)])
    many = values.histogram("p", None, "m")
    found = importance.of_drawn_tests(np.random.default_rng(5).uniform(size=(100_000, 12)), y)
    report = Collector(tmp_path).refresh()
    charts = replace(report.problems[0].charts, rollouts=many, importance=found)
    larger = replace(report, problems=(replace(report.problems[0], charts=charts), *report.problems[1:]))
    assert len(to_json(larger)) - len(to_json(report)) < 30_000

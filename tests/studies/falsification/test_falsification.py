"""The study's own parts: models against published values, all benchmarks, a search, and the page of the results."""

import doctest
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.stl.horizon import check_horizon
from perfbound.orchestrator.mathematics.stl.robustness import evaluated_each
from tests.studies.falsification import figure, page, study
from tests.studies.falsification.benchmark import Benchmark, Floats
from tests.studies.falsification.models import automatic_transmission, chasing_cars, inputs
from tests.studies.falsification.registry import benchmark, benchmarks
from tests.studies.falsification.study import OURS, RESULTS, Row, Run
from tests.studies.pages import PageError

PAGE = Path("docs/falsification.md")
ALL = [pytest.param(each, id=f"{each.name}-{each.instance}") for each in benchmarks()]
AT_ONCE = [
    pytest.param(benchmark(name, instance), id=f"{name}-{instance}")
    for name in ("AT2", "AT51", "CC5")
    for instance in (1, 2)
]


def points(system: Benchmark, count: int) -> Floats:
    low, high = np.array(system.low), np.array(system.high)
    drawn: Floats = low + np.random.default_rng(1).random((count, system.dimension)) * (high - low)
    return drawn


def test_every_model_of_the_competition_is_registered() -> None:
    names = [(each.name, each.instance) for each in benchmarks()]
    assert len(set(names)) == len(names)
    assert {name for name, _ in names} >= {
        *("AT1", "AT2", "AT51", "AT52", "AT53", "AT54", "AT6a", "AT6b", "AT6c", "AT6abc"),
        *("CC1", "CC2", "CC3", "CC4", "CC5", "CCx"),
    }
    assert [benchmark(*name) for name in names] == list(benchmarks())
    with pytest.raises(KeyError, match="no such benchmark; choose one of AT1"):
        benchmark("AT7", 2)


@pytest.mark.parametrize("system", ALL)
def test_a_rollout_is_as_long_as_its_requirement(system: Benchmark) -> None:
    (point,) = points(system, 1)
    times, columns = system.simulate(point)
    check_horizon(system.parsed, float(times[-1]), slack=1e-6)
    assert all(values.shape == times.shape and np.all(np.isfinite(values)) for values in columns.values())
    assert np.isfinite(study.value(system.parsed, (times, columns)))


@pytest.mark.parametrize("system", AT_ONCE)
def test_many_rollouts_at_once_are_those_of_each(system: Benchmark) -> None:
    assert system.simulate_each is not None
    drawn = points(system, 3)
    times, columns = system.simulate_each(drawn)
    found = evaluated_each(system.parsed, ("t", *columns), times, np.stack(list(columns.values()))).robustness
    alone = [study.value(system.parsed, system.simulate(point)) for point in drawn]
    np.testing.assert_allclose(found, alone, rtol=1e-9, atol=1e-9)


def test_the_transmission_is_the_published_one() -> None:
    """Figures at full throttle: STGEM's, measured with the Simulink model of the competition."""
    steps = round(20 / automatic_transmission.STEP) + 1
    _, columns = automatic_transmission.drive(np.full((1, steps), 100.0), np.zeros((1, steps)))
    assert columns["speed"].max() == pytest.approx(120.21327149261522, rel=1e-6)
    assert columns["rpm"].max() == pytest.approx(4768.277187862124, rel=1e-6)
    gears, begin = np.unique(columns["gear"], return_index=True)
    assert gears.tolist() == [1, 2, 3, 4]
    assert begin.tolist() == [0, 256, 616, 1232]


def test_a_car_at_full_throttle_is_at_minus_half_t_squared() -> None:
    steps = round(100 / chasing_cars.STEP) + 1
    times, columns = chasing_cars.drive(np.ones((1, steps)), np.zeros((1, steps)))
    np.testing.assert_allclose(columns["y1"][0], -(times**2) / 2, atol=1e-6)
    # Nobody is behind the first car for long: each follower chases as soon as its gap is 15 m.
    assert columns["y2"][0, times < 3.1].tolist() == [10.0] * int(np.sum(times < 3.1))
    assert columns["y2"][0, -1] < -4000


def test_a_braked_car_has_the_closed_form() -> None:
    steps = round(100 / chasing_cars.STEP) + 1
    times, columns = chasing_cars.drive(np.full((1, steps), 0.5), np.full((1, steps), 0.25))
    np.testing.assert_allclose(columns["y1"][0], -2 * times + 8 * (1 - np.exp(-times / 4)), atol=1e-9)


@pytest.mark.parametrize("name", ["AT2", "CC3"])
def test_our_search_of_twenty_tests_runs(name: str) -> None:
    row = study.measured(Run(name, 2, OURS, 1000, 20))
    assert 1 <= row.simulations <= 20
    assert row.found or row.simulations == 20
    assert row.cpu_ms > 0


def test_a_measurement_continues_where_it_stopped(tmp_path: Path) -> None:
    results = tmp_path / "results.json"
    done = Row(Run("AT2", 2, OURS, 1000, 300), 7, found=True, cpu_ms=1.5)
    study.write([done], results)
    assert study.read(results) == [done]
    assert list(study.measure([done.run], results, processes=1)) == []


def test_a_run_without_a_failure_counts_as_its_budget() -> None:
    found = [Row(Run("AT1", 2, OURS, seed, 300), count, count < 300, 1.0) for seed, count in enumerate((10, 30, 300))]
    assert (page.median(found, 3), page.mean(found)) == ("30 (2/3)", "20.0")
    assert (page.median(found[2:], 1), page.mean(found[2:])) == ("- (0/1)", "-")
    assert (page.median(found[:1], 1), page.median(found[:1], 3)) == ("10", "10 (1/1)")


def rows_of(name: str, **medians: int) -> list[Row]:
    """Return a row of each search: `ours` and `peer`, with this number of simulations of 300."""
    searches = {"ours": OURS, "peer": "CMA-ES"}
    return [Row(Run(name, 2, searches[each], 0, 300), n, n < 300, 1.0) for each, n in medians.items()]


def test_the_verdict_names_where_another_search_is_better() -> None:
    rows = [
        *rows_of("AT1", ours=10, peer=300),
        *rows_of("AT2", ours=11, peer=10),
        *rows_of("AT51", ours=12, peer=10),
        *rows_of("AT52", ours=300, peer=20),
        *rows_of("CC1", ours=10, peer=10),
        *rows_of("CC4", ours=300, peer=300),
        *rows_of("CC5", ours=20),
    ]
    assert page.verdict(rows) == (
        "perfbound has the least median, or an equal one, on AT1, CC1. Within 10 % of the least: AT2. "
        "Behind on AT51 (12; CMA-ES 10), AT52 (300; CMA-ES 20). Falsified by none: CC4."
    )


def test_equal_medians_at_the_budget_are_no_lead() -> None:
    found = [
        Row(Run("AT54", 2, "CMA-ES", seed, 300), count, count < 300, 1.0) for seed, count in enumerate((10, 300, 300))
    ]
    rows = [*rows_of("AT54", ours=300), *found]
    assert page.verdict(rows) == "Falsified by fewer than half of the searches of any kind: AT54 (CMA-ES 1 of 3)."


def test_the_page_has_what_the_generator_writes_from_the_results() -> None:
    rows = study.read(RESULTS)
    assert page.section(rows) in PAGE.read_text(encoding="utf-8")
    assert study.text(rows) == RESULTS.read_text(encoding="utf-8")


def test_the_figure_has_a_mark_for_each_median() -> None:
    rows = [*rows_of("AT1", ours=10, peer=30), *rows_of("AT2", ours=5, peer=300)]
    (ax,) = figure.figure_of(rows).axes
    marks = [line.get_xydata() for line in ax.lines if line.get_marker() != "None"]
    assert sorted(np.vstack([np.asarray(each) for each in marks]).tolist()) == [[5, 1], [10, 0], [30, 0]]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["AT1, 8", "AT2, 4"]


def test_the_figure_is_written_beside_the_page(tmp_path: Path) -> None:
    figure.draw_beside(tmp_path / "page.md", rows_of("AT1", ours=10, peer=30))
    assert (tmp_path / figure.IMAGE).read_bytes().startswith(b"\x89PNG")


def test_a_page_without_marks_is_named(tmp_path: Path) -> None:
    target = tmp_path / "page.md"
    for text in (None, "no marks"):
        if text is not None:
            target.write_text(text, encoding="utf-8")
        with pytest.raises(PageError, match=r"page\.md"):
            page.write(target, [])


@pytest.mark.parametrize("module", [automatic_transmission, inputs])
def test_the_doctests_hold(module: object) -> None:
    assert doctest.testmod(module).failed == 0  # type: ignore[arg-type]

"""The forecast of a bound: what it finds of known courses, where there is none, and that all places show one."""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.campaign import plan as plans
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.forecast import planned_outlook
from perfbound.orchestrator.forecast.outlook import (
    CoursePoint,
    count_words,
    in_words,
    outlook,
    outlook_lines,
)
from perfbound.orchestrator.forecast.planned_outlook import PlannedOutlooks
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.values import MARKED, Bound, ProblemProgress
from tests.campaigns import config as a_config
from tests.facts import says
from tests.fakes.simulators import robustness, simulate, spec

RIGOROUS: dict[str, Any] = {
    "method": "rigorous",
    "alpha": 1e-6,
    "rkhs_norm": 2.0,
    "noise_scale": 0.0,
    "kernel": {"nu": 2.5, "length_scale": 0.5},
}


def course(tests: int, power: float, limit: float = 1.0, start: float = 2.0) -> list[CoursePoint]:
    """Return a bound that falls to a limit, and its distance to it."""
    numbers = [*(n for n in sorted(MARKED) if n < tests), tests]
    return [(n, limit + start * n**-power, start * n**-power) for n in numbers]


@given(st.floats(0.25, 1.0), st.integers(60, 2000), st.integers(2, 10), st.floats(-3, 3))
def test_the_range_contains_a_course_whose_power_is_between_those_fitted(
    power: float, tests: int, factor: int, limit: float
) -> None:
    found = outlook(course(tests, power, limit), least=None, most=factor * tests, per_test=1.0)
    assert found is not None
    truth = limit + 2.0 * (factor * tests) ** -power
    slack = 1e-6
    assert found.bound.low - slack <= truth <= found.bound.high + slack
    assert found.bound.low <= found.bound.middle <= found.bound.high
    assert 0 <= found.gain.low <= found.gain.middle <= found.gain.high


def test_a_known_power_is_continued() -> None:
    found = outlook(course(400, 0.5), least=None, most=1600, per_test=2.0)
    assert found is not None
    assert found.bound.middle == pytest.approx(1 + 2 / 40, abs=2e-3)
    # 1000 rollouts are 500 tests
    assert found.gain.middle == pytest.approx(2 / 40 - 2 / math.sqrt(2100), rel=0.3)


def test_no_bound_falls_below_its_partner_or_rises() -> None:
    found = outlook(course(200, 0.5), least=1.13, most=10**6, per_test=1.0)
    assert found is not None
    assert found.bound.low == 1.13
    assert found.gain.low == 0.0
    rising = [(n, 1.0 + n / 1000, None) for n in sorted(MARKED) if n < 200]
    flat = outlook(rising, least=None, most=1000, per_test=1.0)
    assert flat is not None
    assert flat.bound.middle == flat.bound.high == rising[-1][1]
    assert flat.gain.high == 0.0


@given(st.floats(0.3, 1.0), st.integers(60, 600), st.floats(1.2, 6.0), st.integers(2, 20))
def test_the_range_contains_the_test_at_which_a_known_course_ends(
    power: float, tests: int, later: float, factor: int
) -> None:
    end, most = later * tests, factor * tests
    found = outlook(course(tests, power), least=1.0, most=most, per_test=1.0, alpha=2.0 * end**-power)
    assert found is not None
    truth = min(most, end)
    assert found.tests.low <= truth * (1 + 1e-9)
    assert truth <= found.tests.high * (1 + 1e-9)
    assert tests < found.tests.low <= found.tests.middle <= found.tests.high <= most
    bound = 1.0 + 2.0 * truth**-power
    assert found.bound.low - 1e-6 <= bound <= found.bound.high + 1e-6


def test_a_problem_at_its_tolerance_ends_there() -> None:
    found = outlook(course(100, 0.5), least=1.0, most=400, per_test=1.0, alpha=0.3)
    assert found is not None
    assert count_words(found.tests) == "100"
    assert found.bound.low == found.bound.high == 1.2


@pytest.mark.parametrize("points", [[], course(10, 0.5), [(n, math.inf, None) for n in sorted(MARKED) if n < 900]])
def test_few_bounds_allow_no_forecast(points: list[CoursePoint]) -> None:
    assert outlook(points, least=None, most=1000, per_test=1.0) is None


def progress(stopped_by: Any, *, tests: int = 100, extended: int | None = None) -> ProblemProgress:
    points = course(tests, 0.5)
    return ProblemProgress(tests, 2 * tests, None, Bound(points[-1][1], 0.0, None), stopped_by, extended, tuple(points))


def test_words_have_the_sense_of_the_problem_and_the_budget() -> None:
    config = robustness(RIGOROUS, max_tests=400)
    words = in_words(config, config.problems[0], progress(None))
    assert words is not None
    assert words.startswith("forecast: bound about -1.1 (-1.")
    assert says(words, "400 tests 1,000 further about 0.")
    longer = in_words(config, config.problems[0], progress(None, extended=900))
    assert "after 900 tests" in (longer or "")
    spent = in_words(config, config.problems[0], progress("budget"))
    assert spent is not None
    assert says(spent, "^forecast: 1,000 further rollouts")
    assert in_words(config, config.problems[0], progress("converged")) is None
    sampled = robustness({"method": "sample"}, max_tests=400)
    assert in_words(sampled, sampled.problems[0], progress(None)) is None
    paper = a_config("segway-paper")
    assert in_words(paper, paper.problems[0], progress(None)) is None, "it has no bound before it stops"


def wave(request: RolloutRequest) -> float:
    z1, z2 = request.x
    return 0.7 + 0.4 * math.sin(4 * z1) * math.cos(3 * z2)


@pytest.mark.rest
def test_terminal_status_and_page_show_one_forecast(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    config = robustness(RIGOROUS, max_tests=30, spot_check=0, recheck=0)
    simulate(tmp_path, config, wave, noisy=False)
    status = read_progress(tmp_path)
    with closing(Journal.open(tmp_path)) as journal:
        ledger = Ledger(tmp_path, journal)
        ledger.replay()
        terminal = outlook_lines(config, [each.progress for each in ledger.accounts.values()])
    assert len(terminal) == 1
    assert outlook_lines(config, status.problems) == terminal
    assert f"robustness, {Collector(tmp_path).refresh().problems[0].outlook}" == terminal[0]


KRIGING: dict[str, Any] = {
    "method": "kriging",
    "rkhs_norm": 1.0,
    "prior_mean": -0.7,
    "kernel": {"nu": 2.5, "length_scale": 0.5},
}


def noisy_wave(request: RolloutRequest) -> float:
    return wave(request) + (0.1 if request.seed % 2 else -0.1)


@pytest.mark.rest
def test_a_planned_campaign_has_one_forecast_in_all_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    config = robustness(KRIGING, max_tests=60, replicates=4, resolution=9, clip=(-1, 2), spot_check=0, recheck=0)
    simulate(tmp_path, config, noisy_wave, noisy=True)
    with closing(Journal.open(tmp_path)) as journal:
        ledger = Ledger(tmp_path, journal)
        ledger.replay()
        (account,) = ledger.accounts.values()
        progress = account.progress
        planned = PlannedOutlooks().of(account.plan, ledger.methods[account.plan.key], progress)
    assert planned is not None
    bound, gain = planned
    assert progress.bound is not None
    assert bound.low == bound.middle == bound.high == progress.bound.upper, "nothing is left to come"
    assert 0 < gain.low <= gain.middle <= gain.high < 1
    (terminal,) = outlook_lines(config, [replace(progress, planned=planned)])
    assert says(terminal, "forecast: 1,000 more about 0.")
    assert f"robustness, {Collector(tmp_path).refresh().problems[0].outlook}" == terminal
    running = in_words(config, config.problems[0], replace(progress, planned=planned, stopped_by=None))
    assert running is not None
    assert f"forecast: bound about {-bound.middle:.3g} (" in running
    assert "after 60 tests; a campaign planned" in running
    assert in_words(config, config.problems[0], progress) is None, "without its weights there is none"


def test_a_planned_forecast_is_made_anew_after_a_part_of_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    monkeypatch.setattr(planned_outlook, "planned_outlook", lambda *_: made.append(1))
    config = robustness(KRIGING, max_tests=400, clip=(-1, 2))
    plan = plans.plan(config, spec(noisy=True), config.problems[0])
    outlooks = PlannedOutlooks()
    for tests in range(1, 401):
        outlooks.of(plan, None, progress(None, tests=tests))  # type: ignore[arg-type]
    assert len(made) == planned_outlook.FORECASTS

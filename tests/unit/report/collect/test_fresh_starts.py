"""Fresh starts that fail are part of the data of their problem, and a refuted bound is marked."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.data import page as data
from perfbound.orchestrator.report.data.page import Problem, to_json
from perfbound.schemas.rollout import RolloutRequest
from tests.end_to_end.report import example_reports
from tests.fakes.simulators import noise, robustness, simulate

RIGOROUS = {"method": "rigorous", "alpha": 0.2, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def has_hole(request: RolloutRequest) -> float:
    """Return 0.5, and less than 0 in a hole between the starts of the lattice."""
    z1, z2 = request.x
    return -1.0 if abs(z1 - 0.56) < 0.06 and abs(z2 - 0.56) < 0.06 else 0.5


def problem_of(directory: Path, **changes: float) -> Problem:
    noisy = changes.get("noise_scale", 0.0) > 0
    config = robustness(RIGOROUS | changes, spot_check=200, recheck=0, **({"clip": [-1.5, 1.5]} if noisy else {}))
    assert simulate(directory, config, lambda r: has_hole(r) + noisy * 0.05 * noise(r.seed), noisy=noisy)
    (problem,) = Collector(directory).refresh().problems
    return problem


@pytest.mark.parametrize("noise_scale", [0.0, 0.1])
def test_starts_that_refute_a_bound_are_in_the_data_of_its_problem(tmp_path: Path, noise_scale: float) -> None:
    found = problem_of(tmp_path, noise_scale=noise_scale)
    assert found.refuted
    assert found.bound is not None
    assert min(value for value in found.tests.y if value is not None) > 0.0, "no test fails"
    failing = found.charts.failing
    assert failing
    for each in failing:
        assert all(abs(value - 0.56) < 0.06 for value in each.x)
        assert each.violations == each.rollouts >= 1
        assert each.value == pytest.approx(-1.0, abs=0.3)
        assert each.series == "spot_check"
    assert any(each.contradicts for each in failing)
    assert [each.value for each in failing] == sorted(each.value for each in failing)
    assert (max(each.rollouts for each in failing) > 1) == (noise_scale > 0.0), "follow-ups count"


def test_nothing_fails_where_nothing_is_wrong(tmp_path: Path) -> None:
    config = robustness(RIGOROUS, spot_check=50, recheck=0)
    assert simulate(tmp_path, config, lambda _: 0.5, noisy=False)
    (problem,) = Collector(tmp_path).refresh().problems
    assert (problem.refuted, problem.charts.failing) == (False, ())


def test_a_bound_of_the_page_is_no_stronger_than_that_of_the_certificate() -> None:
    """The page rounds down to four decimals: a number that was rounded up before would give 1.8067."""
    report = example_reports.small()
    first, *others = report.problems
    # Seven digits of the first are 1.8067; the second is a decimal number but for the last bits.
    lower, upper = (1.80669996, 0.1 + 0.2), (1.80670004, -0.3)
    tests = data.TestSeries((0, 1), first.tests.x[:2], (1.0, 1.0), (None, None), lower, upper)
    exact = 1.80669996
    claim = replace(report.claims[0], bound=exact, probability=0.94999999)
    page = json.loads(
        to_json(replace(report, claims=(claim,), problems=(replace(first, bound=exact, tests=tests), *others)))
    )
    problem, (claimed, *_) = page["problems"][0], page["claims"]
    assert (claimed["bound"], claimed["probability"], problem["bound"]) == (exact, 0.94999999, exact)
    assert problem["tests"]["lower"] == [1.806699, 0.3]
    assert problem["tests"]["upper"] == [1.806701, -0.3]

"""Method `kriging` in campaigns: its keys, its problems, their certificates, and what `verify` finds."""

import itertools
import json
import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

import perfbound as pb
from perfbound.orchestrator.campaign.methods import method
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import notes
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingMethod
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.read import read_header, reading
from perfbound.schemas.base import canonical_json
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.defaults import completed
from perfbound.schemas.result.certificate import Predicate
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import SystemSpec
from tests.campaigns import table
from tests.facts import says
from tests.fakes.finished import finish, play
from tests.fakes.simulators import noise, robustness, simulate, spec, verified
from tests.tampering import editing

KRIGING: dict[str, Any] = {
    "method": "kriging",
    "rkhs_norm": 0.3,
    "prior_mean": -0.5,
    "kernel": {"nu": 2.5, "length_scale": 0.8},
    "spread": 0.05,
}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def a_campaign(problem: dict[str, Any] | None = None, **changes: Any) -> CampaignConfig:
    """Return a campaign about the unit square, without checks afterwards."""
    found: dict[str, Any] = {"clip": [-0.1, 1.0], "max_tests": 40, "replicates": 8, "recheck": 0, "spot_check": 0}
    return robustness({**KRIGING, **(problem or {})}, **found | changes)


def shaky(request: RolloutRequest) -> float:
    return 0.4 + 0.2 * request.x[0] + 0.02 * min(max(noise(request.seed), -3.0), 3.0)


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


def statuses(found: Predicate) -> dict[str, str]:
    return {each.id: each.status for each in found.assumptions}


class TestCampaigns:
    @pytest.mark.rest
    def test_the_claim_is_between_the_assumption_and_the_truth(self, tmp_path: Path) -> None:
        simulate(tmp_path, a_campaign(spot_check=10, spot_check_followups=4, recheck=2), shaky, noisy=True)
        found = predicate(tmp_path)
        (claim,), (problem,) = found.claims, found.problems
        assert 0.2 + 0.1 < claim.bound <= 0.4
        assert (claim.quantity, claim.sense, claim.probability) == ("expected_robustness", ">=", 0.95)
        assert (claim.method, claim.without_data, claim.refuted) == ("kriging", 0.2, ())
        assert (problem.tests, problem.rollouts.nominal, problem.stopped_by) == (40, 320, "budget")
        assert (problem.partner, problem.parameters.get("alpha")) == (None, None)
        status = statuses(found)
        assert status["rkhs_norm/robustness"] == status["bounds_agree/robustness"] == "not refuted"
        derived = ("bounded_values", "lattice", "design")
        assert {status[f"{name}/robustness"] for name in derived} == {"derived"}
        assert "noise_scale/robustness" not in status
        assert [(row.constant, row.factor) for row in found.sensitivity or ()] == [
            ("rkhs_norm", 2.0),
            ("rkhs_norm", 4.0),
            ("length_scale", 0.5),
        ]
        assert all(row.bound is not None and row.bound < claim.bound for row in found.sensitivity or ())
        assert says(notes(found, 0)[0], "0.2000")
        assert not verified(tmp_path)

    @pytest.mark.rest
    def test_the_report_has_the_band_of_all_cells_and_no_tolerance(self, tmp_path: Path) -> None:
        simulate(tmp_path, a_campaign(), shaky, noisy=True)
        (problem,) = Collector(tmp_path).refresh().problems
        (surface,) = problem.surfaces
        assert problem.bound is not None
        lower = [value for value in surface.lower if value is not None]
        assert len(lower) == 81
        assert min(lower) < problem.bound
        assert set(surface.upper) == {None}
        assert "all cells at once" in surface.band
        assert (problem.alpha, problem.left) == (None, None)
        assert problem.tests.distance == (None,) * 40

    @pytest.mark.rest
    def test_a_norm_that_is_too_small_ends_the_campaign_refuted(self, tmp_path: Path) -> None:
        def steep(request: RolloutRequest) -> float:
            return 0.1 + 0.8 * request.x[0] + 0.01 * min(max(noise(request.seed), -3.0), 3.0)

        config = a_campaign({"rkhs_norm": 0.05, "spread": 0.02}, max_tests=200)
        simulate(tmp_path, config, steep, noisy=True)
        found = predicate(tmp_path)
        assert found.problems[0].stopped_by == "refuted"
        assert statuses(found)["rkhs_norm/robustness"] == "refuted"
        assert "rkhs_norm/robustness" in found.claims[0].refuted
        assert not verified(tmp_path)

    @pytest.mark.rest
    def test_requirements_share_the_planned_tests(self, tmp_path: Path) -> None:
        listed = [
            {"name": "low", "formula": "value >= 0"},
            {"name": "high", "formula": "0.9 - value >= 0", "prior_mean": -0.4},
        ]
        config = a_campaign(specification=None, specifications=listed)
        simulate(tmp_path, config, shaky, noisy=True)
        found = predicate(tmp_path)
        whole, low, high = found.claims
        assert (whole.rule, low.requirement, high.requirement) == ("every", "low", "high")
        assert whole.bound == min(low.bound, high.bound)
        assert 0.3 < low.bound <= 0.4
        assert 0.2 < high.bound <= 0.3
        assert [each.tests for each in found.problems] == [40, 40]
        assert not verified(tmp_path)

    @pytest.mark.rest
    def test_a_counterexample_ends_it_with_the_bound_of_that_moment(self, tmp_path: Path) -> None:
        def falls(request: RolloutRequest) -> float:
            return -0.05 if noise(request.seed) < -2.2 else shaky(request)

        simulate(tmp_path, a_campaign(until_counterexample=True), falls, noisy=True)
        found = predicate(tmp_path)
        assert found.problems[0].stopped_by == "counterexample"
        assert found.problems[0].tests < 40
        assert found.claims[0].bound <= 0.4
        assert not verified(tmp_path)


WINDY = spec(noisy=True).model_copy(
    update={"disturbances": (pb.Normal(0, 1).named("wind", ""), pb.Choice([0, 1]).named("flap", "")), "residual": False}
)


def windy(request: RolloutRequest) -> float:
    wind, flap = request.disturbances
    return 0.4 + 0.2 * request.x[0] + 0.2 * math.tanh(wind) + 0.1 * (2 * flap - 1)


class TestDisturbances:
    def test_a_control_raises_the_bound_and_the_certificate_says_so(self, tmp_path: Path) -> None:
        simulate(tmp_path / "on", a_campaign(max_tests=80), windy, noisy=True, system=WINDY)
        simulate(tmp_path / "off", a_campaign(max_tests=80, control="off"), windy, noisy=True, system=WINDY)
        on, off = predicate(tmp_path / "on"), predicate(tmp_path / "off")
        assert on.claims[0].bound <= 0.4
        (found,) = on.problems
        assert found.control is not None
        assert found.control.explained > 0.95
        assert (found.control.before_fit, off.problems[0].control) == (40, None)
        wind, flap = found.control.disturbances
        assert (wind.name, flap.name, flap.knots) == ("wind", "flap", (0.0, 1.0))
        assert flap.levels[0][1] - flap.levels[0][0] == pytest.approx(0.2, abs=0.02), "of the robustness"
        rows = {row.constant: row.bound for row in on.sensitivity or ()}
        assert rows["control"] is not None
        assert rows["control"] < on.claims[0].bound
        assert "control" not in {row.constant for row in off.sensitivity or ()}
        assert wind.standard_deviation == pytest.approx(0.2 * 0.6279, abs=0.01), "of tanh of a normal number"
        assert flap.standard_deviation == pytest.approx(0.1, abs=0.01)
        assert "control" not in notes(on, 0)[1]
        assert says(notes(on, 0)[2], "^The declared disturbances raise the bound explain % most of it wind")
        assert says(notes(off, 0)[1], "^The same tests")
        assert not verified(tmp_path / "on")

    @pytest.mark.rest
    def test_workers_and_stops_change_no_byte(self, tmp_path: Path) -> None:
        simulate(tmp_path / "five", a_campaign(), windy, noisy=True, system=WINDY, workers=5)
        seen = itertools.count()
        stopped = simulate(
            tmp_path / "cut", a_campaign(), windy, noisy=True, system=WINDY, stop=lambda _: next(seen) == 150
        )
        assert stopped is None
        simulate(tmp_path / "cut", a_campaign(), windy, noisy=True, system=WINDY)
        assert (tmp_path / "five" / files.CERTIFICATE).read_bytes() == (
            tmp_path / "cut" / files.CERTIFICATE
        ).read_bytes()

    @pytest.mark.rest
    def test_a_forged_control_is_found(self, tmp_path: Path) -> None:
        simulate(tmp_path, a_campaign(), windy, noisy=True, system=WINDY)
        path = tmp_path / files.CERTIFICATE
        found = json.loads(path.read_text())
        found["predicate"]["problems"][0]["control"]["disturbances"][0]["levels"][0][3] += 0.01
        path.write_text(json.dumps(found))
        assert verified(tmp_path)

    def test_other_laws_than_those_of_the_file_are_found(self, tmp_path: Path) -> None:
        laws = {"wind": {"distribution": "normal", "mean": 0.0, "sd": 0.5}}
        config = a_campaign(disturbances=laws, max_tests=9)
        simulate(tmp_path, config, windy, noisy=True, system=WINDY)
        assert not verified(tmp_path)
        with editing(tmp_path) as database:
            (text,) = database.execute("SELECT system FROM campaign").fetchone()
            stored = SystemSpec.model_validate_json(text)
            assert stored.disturbances[0].sd == 0.5
            # As if the values had been drawn from the laws of the system: its digest is the same.
            database.execute("UPDATE campaign SET system = ?", (canonical_json(WINDY.model_dump(mode="json")),))
        assert verified(tmp_path) == ["header"]

    @pytest.mark.rest
    def test_where_disturbances_explain_nothing_there_is_no_control(self, tmp_path: Path) -> None:
        def other(request: RolloutRequest) -> float:
            return 0.4 + 0.2 * request.x[0] + 0.05 * math.sin(1e6 * request.disturbances[0])

        simulate(tmp_path, a_campaign(), other, noisy=True, system=WINDY)
        found = predicate(tmp_path)
        assert 0.2 < found.claims[0].bound <= 0.4
        assert found.problems[0].control is None or found.problems[0].control.explained < 0.1
        assert not verified(tmp_path)


def two_systems(problems: list[dict[str, Any]], **changes: Any) -> CampaignConfig:
    """Return a campaign of the test function, whose puppets answer with values in [0, .1]."""
    found = table("test-function", horizon=0.3, specification="always (value >= 0.002)", clip=[-0.05, 0.15])
    found |= {"resolution": 7, "max_tests": 12, "replicates": 4, "problems": problems, **changes}
    return CampaignConfig.model_validate_json(json.dumps(found))


def finished(directory: Path, config: CampaignConfig) -> Predicate:
    finish(play(directory, config), directory)
    assert not verified(directory)
    return predicate(directory)


class TestTwoSystems:
    @pytest.mark.rest
    def test_the_risk_is_bounded_through_its_expectation(self, tmp_path: Path) -> None:
        risk = KRIGING | {"name": "true_risk", "prior_mean": 0.0, "linearised": {"centre": 0.05, "spread": 0.03}}
        found = finished(tmp_path / "run", two_systems([risk | {"kernel": {"length_scale": 3.0}}]))
        (claim,), (problem,) = found.claims, found.problems
        assert claim.quantity == "rho_star"
        assert problem.objective.endswith("through the expectation that bounds it")
        assert problem.rollouts.true == 48
        assert {"linearised/true_risk", "clip/true_risk"} <= set(claim.assumptions)
        assert claim.by_clip is not None
        assert claim.bound >= claim.by_clip

    @pytest.mark.rest
    def test_the_gap_composes_with_a_rigorous_nominal_bound(self, tmp_path: Path) -> None:
        shared = {"rkhs_norm": 0.1, "kernel": {"nu": 2.5, "length_scale": 3.0}}
        nominal = {"name": "nominal_robustness", "method": "rigorous", "alpha": 0.01, "noise_scale": "derived"}
        gap = {"name": "sim_gap", "method": "kriging", "spread": 0.03, "prior_mean": 0.0}
        config = two_systems(
            [nominal | shared | {"prior_mean": -0.05}, gap | shared],
            composition="bhatia-davis",
            gap={"kind": "robustness"},
        )
        found = finished(tmp_path / "run", config)
        assert [claim.rule for claim in found.claims] == ["bhatia-davis", "sum"]
        assert found.claims[0].method == "rigorous + kriging"
        # The nominal system is deterministic, so that its bound spends no delta.
        assert [each.probability for each in found.problems] == [1.0, 0.95]
        assert found.claims[0].probability == 0.95
        bound = next(each for each in found.problems if each.name == "sim_gap")
        assert (bound.sense, bound.method) == ("max", "kriging")
        assert 0.0 < bound.bound <= 0.1


@pytest.mark.parametrize(
    ("problem", "changes", "message"),
    [
        ({"name": "nominal_robustness"}, {}, "name: 'kriging' 'sim_gap' 'true_risk' 'robustness'"),
        ({"name": "true_risk"}, {}, "linearised: required 'true_risk' 'kriging'"),
        ({"linearised": {"centre": 0.1, "spread": 0.1}}, {}, "linearised: required by"),
        ({"window": 3}, {}, "window: 'kriging'"),
        ({"alpha": 0.1}, {}, "alpha"),
        ({"noise_scale": "derived"}, {}, "noise_scale"),
        ({"kernel": {"nu": 45, "length_scale": 1.0}}, {}, "kernel.nu: 45 must be at most 40"),
        ({"points": 10}, {"resolution": 30}, "points"),
        ({"points": 5}, {"resolution": 4}, "problems.robustness.points: 5 more 4"),
        ({}, {"resolution": 101}, "resolution: 10,201 more 10,000"),
        ({}, {"space": {"scenarios": [[0.1, 0.1]]}}, "'kriging' needs a box"),
        ({}, {"falsify": {}}, "falsify: 'kriging'"),
        ({}, {"where": "z1 <= z2"}, "space.where: 'kriging'"),
        ({}, {"candidates": 64}, "candidates"),
        ({}, {"clip": None}, "clip: required 'robustness'"),
        ({}, {"space": {name: {"low": 0, "high": 1} for name in "abcdefg"}}, "at most 6 parameters"),
        ({"points": 3}, {"space": {name: {"low": 0, "high": 1} for name in "abcd"}}, "points: at most 3 parameters"),
    ],
)
def test_what_it_cannot_do_is_refused_with_a_remedy(
    problem: dict[str, Any], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValidationError) as raised:
        a_campaign(problem, **changes)
    assert says(str(raised.value), message)


@pytest.mark.rest
def test_length_scales_and_points_have_defaults(tmp_path: Path) -> None:
    without = {key: value for key, value in KRIGING.items() if key not in {"kernel", "spread"}}
    found = completed({"method": "kriging", "rkhs_norm": 1.0, "space": {"z1": [0, 1], "z2": [0, 4]}}, "box")
    assert found["problems"][0]["kernel"] == {"length_scale": {"z1": 0.5, "z2": 2.0}}
    config = a_campaign(without | {"kernel": {"length_scale": 0.5}}, max_tests=100, replicates=4)
    simulate(tmp_path, config, shaky, noisy=True)
    with reading(tmp_path) as connection:
        header = read_header(connection, tmp_path)
    (plan,) = plans(header.config, header.spec).values()
    made = method(plan, header)
    assert isinstance(made, KrigingMethod)
    assert made.design.size == 25
    assert plan.window == 100  # no start depends on a rollout

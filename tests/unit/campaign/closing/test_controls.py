"""Campaigns of methods `scenario` and `sample` with declared disturbances: what their certificates say, and verify."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.methods import method
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import notes
from perfbound.orchestrator.mathematics.bounds.sample import SampleMethod
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import facts
from perfbound.orchestrator.store.read import read_header, reading
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Predicate
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import robustness, simulate, spec, verified

WINDY = spec(noisy=True).model_copy(
    update={"disturbances": (pb.Normal(0, 1).named("wind", ""), pb.Choice([0, 1]).named("flap", "")), "residual": False}
)
SCENARIO = {"method": "scenario", "alpha": 1e-6}
CLAIMS = [{"quantity": name} for name in ("mean", "risk", "failure_probability")]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def windy(request: RolloutRequest) -> float:
    wind, flap = request.disturbances
    return 0.4 + 0.02 * request.x[0] + 0.2 * math.tanh(wind) + 0.1 * (2 * flap - 1)


def of_scenarios(**changes: Any) -> CampaignConfig:
    """Return a campaign about two starts, of 900 rollouts."""
    found = {"clip": [-0.1, 1.0], "max_tests": 30, "replicates": 30, "recheck": 0, "spot_check": 0, "window": 2}
    return robustness(SCENARIO, space={"scenarios": [[0.0, 0.0], [1.0, 1.0]]}, **found | changes)


def of_samples(**changes: Any) -> CampaignConfig:
    """Return a campaign of 600 drawn starts."""
    found = {"clip": [-0.1, 1.0], "max_tests": 600, "replicates": 1, "recheck": 0, "spot_check": 0}
    return robustness({"method": "sample"}, claims=CLAIMS, **found | changes)


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


@pytest.mark.rest
def test_beside_a_search_a_control_explains_the_drawn_tests_alone(tmp_path: Path) -> None:
    # Half of the tests, each with the disturbances of its own seed.
    campaign = of_samples(max_tests=200, falsify={"random_every": 2})
    simulate(tmp_path / "on", campaign, windy, noisy=True, system=WINDY)
    on = predicate(tmp_path / "on")
    (found,) = on.problems
    assert found.control is not None
    assert found.control.explained > 0.7
    # Starts that the search chose are no samples, without a control as with one.
    with reading(tmp_path / "on") as connection:
        header = read_header(connection, tmp_path / "on")
    (plan,) = plans(header.config, header.spec).values()
    without = method(replace(plan, controlled=False), header)
    tests = [each for each in facts.history(tmp_path / "on")["robustness"] if plan.is_drawn(each.test)]
    assert isinstance(without, SampleMethod)
    without.recall([(each.proposal, each.observation) for each in tests])
    assert (upper := without.bound().upper) is not None
    assert (on.sensitivity or ())[0].bound == pytest.approx(-upper)
    assert not verified(tmp_path / "on")


@pytest.mark.rest
@pytest.mark.parametrize("campaign", [of_scenarios, of_samples])
def test_a_control_raises_the_bound_and_the_certificate_says_so(campaign: Any, tmp_path: Path) -> None:
    simulate(tmp_path / "on", campaign(), windy, noisy=True, system=WINDY)
    on = predicate(tmp_path / "on")
    assert on.claims[0].bound <= 0.41
    (found,) = on.problems
    assert found.control is not None
    assert found.control.explained > 0.9
    assert [each.name for each in found.control.disturbances] == ["wind", "flap"]
    flap = found.control.disturbances[1].levels[0]
    assert flap[1] - flap[0] == pytest.approx(0.2, abs=0.02), "of the robustness"
    rows = {row.claim: row for row in on.sensitivity or ()}
    assert {row.constant for row in rows.values()} == {"control"}
    # Failures are counted, with or without a control.
    assert set(rows) == ({0} if campaign is of_scenarios else {0, 1})
    for k, row in rows.items():
        assert row.bound is not None
        assert row.bound < on.claims[k].bound
    assert any(
        says(note, "disturbances raise the bound explain % of the variance of a rollout") for note in notes(on, 0)
    )
    assert not verified(tmp_path / "on")
    path = tmp_path / "on" / files.CERTIFICATE
    forged = json.loads(path.read_text())
    forged["predicate"]["problems"][0]["control"]["disturbances"][0]["levels"][0][3] += 0.01
    path.write_text(json.dumps(forged))
    assert verified(tmp_path / "on")


@pytest.mark.rest
@pytest.mark.parametrize("campaign", [of_scenarios, of_samples])
def test_without_it_the_certificate_has_none(campaign: Any, tmp_path: Path) -> None:
    simulate(tmp_path, campaign(control="off", max_tests=20), windy, noisy=True, system=WINDY)
    found = predicate(tmp_path)
    assert (found.sensitivity, found.problems[0].control) == (None, None)
    assert not verified(tmp_path)


@pytest.mark.rest
@pytest.mark.parametrize("campaign", [of_scenarios, of_samples])
def test_workers_batches_and_stops_change_no_byte(campaign: Any, tmp_path: Path) -> None:
    changes = {"max_tests": 20 if campaign is of_scenarios else 150}
    simulate(tmp_path / "one", campaign(**changes), windy, noisy=True, system=WINDY)
    simulate(tmp_path / "five", campaign(**changes), windy, noisy=True, system=WINDY, workers=5)
    seen = itertools.count()
    config = campaign(**changes)
    stopped = simulate(tmp_path / "cut", config, windy, noisy=True, system=WINDY, stop=lambda _: next(seen) == 100)
    assert stopped is None
    simulate(tmp_path / "cut", config, windy, noisy=True, system=WINDY)
    one, five, cut = ((tmp_path / name / files.CERTIFICATE).read_bytes() for name in ("one", "five", "cut"))
    assert one == five == cut
    assert predicate(tmp_path / "one").problems[0].control is not None


@pytest.mark.parametrize("quantities", [["failure_probability"], ["quantile", "next_rollout"]])
def test_counts_and_ranks_have_no_control(quantities: list[str]) -> None:
    claims = [{"quantity": each} | ({} if each.startswith("f") else {"level": 0.1}) for each in quantities]
    config = robustness({"method": "sample"}, claims=claims, clip=[-0.1, 1.0])
    (plan,) = plans(config, WINDY).values()
    assert not plan.controlled

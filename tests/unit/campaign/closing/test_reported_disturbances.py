"""Campaigns on a system that draws its disturbances by itself, and reports them in columns."""

import csv
import json
import math
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.export import export
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Predicate
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, SystemSpec
from tests.fakes.simulators import Function, robustness, simulate, spec, verified

REPORTED = (pb.Normal(0, 1).named("wind", ""), pb.Choice([0, 1]).named("flap", ""))
SYSTEM = spec(noisy=True)
WINDY = SYSTEM.model_copy(
    update={
        "columns": (*SYSTEM.columns, Column(name="wind", unit=""), Column(name="flap", unit="")),
        "reported": REPORTED,
    }
)
METHODS: dict[str, dict[str, Any]] = {
    "kriging": {
        "problem": {"method": "kriging", "rkhs_norm": 0.1, "prior_mean": -0.4, "kernel": {"length_scale": 2.0}},
        "max_tests": 60,
        "replicates": 10,
    },
    "scenario": {
        "problem": {"method": "scenario", "alpha": 1e-6},
        "space": {"scenarios": [[0.0, 0.0], [1.0, 1.0]]},
        "max_tests": 30,
        "replicates": 30,
        "window": 2,
    },
    "sample": {"problem": {"method": "sample"}, "claims": [{"quantity": "mean"}], "max_tests": 600, "replicates": 1},
}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def windy(scale: float = 1.0) -> Function:
    """Return a system whose wind has a standard deviation of `scale`, where 1 is declared."""

    def value(request: RolloutRequest) -> tuple[float, ...]:
        rng = np.random.default_rng(request.seed)
        wind, flap = scale * rng.standard_normal(), float(rng.integers(2))
        margin = 0.4 + 0.02 * request.x[0] + 0.2 * math.tanh(wind) + 0.1 * (2 * flap - 1)
        return margin, wind, flap

    return value


def campaign(method: str, **changes: Any) -> CampaignConfig:
    found = {"clip": [-0.1, 1.0], "recheck": 0, "spot_check": 0} | METHODS[method] | changes
    problem: Any = found.pop("problem")
    return robustness(problem, **found)


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


@pytest.mark.parametrize("method", METHODS)
def test_a_control_takes_what_rollouts_report(method: str, tmp_path: Path) -> None:
    simulate(tmp_path / "on", campaign(method), windy(), noisy=True, system=WINDY)
    found = predicate(tmp_path / "on")
    (problem,) = found.problems
    assert problem.control is not None
    assert problem.control.explained > 0.9
    assert [each.name for each in problem.control.disturbances] == ["wind", "flap"]
    rows = [row.bound for row in found.sensitivity or () if row.constant == "control"]
    assert rows[0] is not None
    assert rows[0] < found.claims[0].bound <= 0.41
    (law,) = [each for each in found.assumptions if each.id.startswith("declared_laws/")]
    assert law.status == "not refuted"
    assert law.values["values"] == problem.tests * METHODS[method]["replicates"]
    (order,) = [each for each in found.assumptions if each.id.startswith("one_law_per_start/")]
    assert int(order.values["values"]) <= int(law.values["values"]), "no reported value is one of a start"
    assert not verified(tmp_path / "on")


@pytest.mark.parametrize("on_refuted", ["continue", "stop"])
def test_a_law_that_rollouts_do_not_keep_is_refuted(on_refuted: str, tmp_path: Path) -> None:
    simulate(tmp_path, campaign("scenario", on_refuted=on_refuted), windy(1.5), noisy=True, system=WINDY)
    found = predicate(tmp_path)
    assert "declared_laws/robustness" in found.claims[0].refuted
    (law,) = [each for each in found.assumptions if each.id.startswith("declared_laws/")]
    assert law.status == "refuted"
    assert "the values of wind that rollouts report do not have its declared law, normal, mean 0, sd 1 (" in law.detail
    assert (found.problems[0].stopped_by == "refuted") == (on_refuted == "stop")
    assert not verified(tmp_path)


def test_a_value_that_the_law_does_not_have_refutes_it_at_once(tmp_path: Path) -> None:
    def between(request: RolloutRequest) -> tuple[float, ...]:
        margin, wind, flap = map(float, np.atleast_1d(windy()(request)))
        return margin, wind, 0.5 if request.test == 7 else flap

    simulate(tmp_path, campaign("sample", max_tests=40), between, noisy=True, system=WINDY)
    (law,) = [each for each in predicate(tmp_path).assumptions if each.id.startswith("declared_laws/")]
    assert (
        "rollouts report values of flap that its declared law, 0 (0.5), 1 (0.5), does not have (1 of 40)" in law.detail
    )


def test_without_a_control_nothing_is_read_of_them(tmp_path: Path) -> None:
    simulate(tmp_path, campaign("sample", control="off", max_tests=40), windy(2.0), noisy=True, system=WINDY)
    assert not [each for each in predicate(tmp_path).assumptions if each.id.startswith("declared_laws/")]


def test_a_forged_value_is_found(tmp_path: Path) -> None:
    simulate(tmp_path, campaign("sample", max_tests=40), windy(), noisy=True, system=WINDY)
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection, connection:
        connection.execute("DROP TRIGGER observations_no_update")
        (each,) = connection.execute("SELECT each FROM observations WHERE test = 3").fetchone()
        forged = json.dumps([*json.loads(each)[:-2], 0.0, 1.0])
        connection.execute("UPDATE observations SET each = ? WHERE test = 3", (forged,))
    assert verified(tmp_path)


def test_samples_in_which_they_are_reported_are_kept() -> None:
    of_batches = {"batch": 8, "keep": "failures"}
    with pytest.raises(CampaignError, match="keep: 'failures' drops samples, in which any-function reports"):
        check(campaign("sample", **of_batches), WINDY, "file")
    check(campaign("sample", control="off", **of_batches), WINDY, "file")


def test_tables_and_histograms_have_the_values_alone(tmp_path: Path) -> None:
    requirements = [{"name": "a", "formula": "value >= 0"}, {"name": "b", "formula": "value >= -1"}]
    changes = {"specification": None, "specifications": requirements, "replicates": 4, "max_tests": 20}
    simulate(tmp_path, campaign("sample", clip=[-0.1, 2.0], **changes), windy(), noisy=True, system=WINDY)
    (problem,) = Collector(tmp_path).refresh().problems
    histograms = [each for each in (problem.drawn, *problem.requirements) if each is not None]
    assert len(histograms) == 3
    whole, first, second = (each.least for each in histograms)
    assert (whole, first, second) == pytest.approx((0.12, 0.12, 1.12), abs=0.05), "no wind and no flap"
    export(tmp_path, tmp_path / "tables", ["observations"])
    with (tmp_path / "tables/observations.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == 20 * 4
    assert all(0.0 < float(row["contribution"]) < 1.0 for row in rows)


def test_a_report_shows_the_control_of_what_rollouts_report(tmp_path: Path) -> None:
    simulate(tmp_path, campaign("kriging"), windy(), noisy=True, system=WINDY)
    report = Collector(tmp_path).refresh()
    charts = report.problems[0].charts.disturbances
    assert charts is not None
    assert [report.disturbances[each.place].name for each in charts.shares] == ["wind", "flap"]
    assert charts.shares[0].share == pytest.approx(0.6, abs=0.1)
    assert (charts.scatter, charts.worst) == (None, None), "their values are in the files alone"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"reported": (pb.Normal(0, 1).named("gust", ""),)}, "'gust' is no column"),
        ({"reported": (pb.Normal(0, 1).named("wind", "m/s"),)}, "wind is in 'm/s', and its column in ''"),
        ({"noisy": ()}, "no variant is noisy"),
        ({"reported": (*REPORTED, REPORTED[0])}, "every number needs a column of its own"),
        ({"reported": (pb.Choice([1, 1, 2]).named("flap", ""),)}, "flap has a choice twice"),
        ({"disturbances": REPORTED[:1]}, "wind is drawn by the campaign"),
    ],
)
def test_what_a_system_cannot_report_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SystemSpec.model_validate(WINDY.model_dump() | changes)

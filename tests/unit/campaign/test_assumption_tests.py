"""A campaign with `on_refuted`: where it ends, that nothing but the tests decides it, and what the certificate says."""

import json
import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from pydantic import ValidationError

from perfbound.orchestrator.campaign.assumption_tests import OneLaw, spread
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.plan import ProblemPlan
from perfbound.orchestrator.campaign.series import Rows
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.mathematics.bounds.checks.stationarity import AdaptiveOrderTest
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.rollout import RolloutRequest
from tests.campaigns import config as a_config
from tests.facts import facts
from tests.fakes.simulators import certificates, noise, robustness, simulate, verified

RIGOROUS = {
    "method": "rigorous",
    "alpha": 1e-3,
    "rkhs_norm": 8.0,
    "noise_scale": 0.05,
    "kernel": {"nu": 2.5, "length_scale": 1.0},
}
EXACT = RIGOROUS | {"noise_scale": 0.0}
SCENARIO = {"method": "scenario", "alpha": 1e-6, "replicates": 6}
LIST = {"space": {"scenarios": [[0.2, 0.2], [0.5, 0.8], [0.9, 0.4]]}}
STOP = {"on_refuted": "stop"}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def loud(request: RolloutRequest) -> float:
    """Return values with half as much noise again as the campaign assumes."""
    return 0.5 + 0.075 * noise(request.seed)


def quiet(request: RolloutRequest) -> float:
    return 0.5 + 0.01 * noise(request.seed)


def noisy(**changes: Any) -> CampaignConfig:
    base = {"clip": [-10, 10], "replicates": 4, "max_tests": 30, "window": 2, "recheck": 3, "spot_check": 20}
    return robustness(RIGOROUS, **(base | changes))


def finished(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


@pytest.mark.rest
def test_a_noise_scale_that_is_refuted_ends_the_campaign(tmp_path: Path) -> None:
    simulate(tmp_path / "stop", noisy(**STOP), loud, noisy=True)
    simulate(tmp_path / "continue", noisy(), loud, noisy=True)
    stopped, continued = (finished(tmp_path / name).predicate for name in ("stop", "continue"))
    (problem,), (whole,) = stopped.problems, continued.problems
    assert problem.stopped_by == "refuted"
    assert problem.tests < whole.tests == 30
    assert "replicate_spread/robustness" in stopped.claims[0].refuted
    assert "replicate_spread/robustness" in continued.claims[0].refuted
    assert stopped.spot_check is None
    assert continued.spot_check is not None
    assert stopped.question["on_refuted"] == "stop"
    assert "on_refuted" not in continued.question
    assert verified(tmp_path / "stop") == []
    assert verified(tmp_path / "continue") == []


@pytest.mark.rest
def test_it_ends_at_the_first_test_that_refutes_however_many_workers_there_are(tmp_path: Path) -> None:
    found = certificates(tmp_path, noisy(**STOP), loud, noisy=True, cut_after=9)
    assert len(found) == 1
    with closing(Journal.open(tmp_path / "one")) as journal:
        ledger = Ledger(tmp_path / "one", journal)
        ledger.replay()
        (account,) = ledger.accounts.values()
    assert len(account.each) > 2
    before = replace(account, each=Rows(account.each[:-1]))
    for tested, status in ((account, "refuted"), (before, "not refuted")):
        finding = spread(tested, 0.05)
        assert finding is not None
        # Above the noise scale, and below what refutes it, there is a hint.
        assert finding.status == status or (status == "not refuted" and finding.status == "assumed")


def test_what_is_not_refuted_is_not_stopped(tmp_path: Path) -> None:
    simulate(tmp_path / "stop", noisy(**STOP), quiet, noisy=True)
    found = finished(tmp_path / "stop").predicate
    assert found.problems[0].stopped_by == "budget"
    assert not found.claims[0].refuted


def test_a_system_without_noise_that_does_not_repeat_itself_ends_it(tmp_path: Path) -> None:
    calls: list[None] = []

    def forgetful(_: RolloutRequest) -> float:
        calls.append(None)
        return 0.5 + 1e-9 * len(calls)

    config = robustness(EXACT, clip=[-10, 10], replicates=2, max_tests=20, recheck=0, spot_check=0, **STOP)
    simulate(tmp_path, config, forgetful, noisy=False)
    (problem,) = finished(tmp_path).predicate.problems
    assert (problem.stopped_by, problem.tests) == ("refuted", 1)
    assert "deterministic/robustness" in finished(tmp_path).predicate.claims[0].refuted


def test_a_system_that_drifts_ends_a_scenario_campaign(tmp_path: Path) -> None:
    def drifting(request: RolloutRequest) -> float:
        return 0.02 * int(request.rollout.split(".")[1]) + 0.01 * noise(request.seed)

    config = robustness(SCENARIO, clip=[-1, 5], max_tests=200, recheck=0, **LIST, **STOP)
    simulate(tmp_path, config, drifting, noisy=True)
    found = finished(tmp_path).predicate
    assert found.problems[0].stopped_by == "refuted"
    assert found.problems[0].tests < 200
    assert "one_law_per_start/robustness" in found.claims[0].refuted
    assert verified(tmp_path) == []


def test_the_key_is_part_of_the_identity_where_it_is_set_and_nothing_where_it_is_not() -> None:
    assert noisy(on_refuted="continue").digest == noisy().digest
    assert noisy(**STOP).digest != noisy().digest
    assert "on_refuted" not in json.loads(noisy(on_refuted="continue").model_dump_json())


@pytest.mark.parametrize("name", ["segway-paper", "segway-direct"])
def test_it_is_refused_where_the_number_of_tests_is_fixed(name: str) -> None:
    with pytest.raises(ValidationError, match=facts("on_refuted: 'stop' 'paper'")):
        a_config(name, **STOP)
    sampled = {"method": "sample"}
    with pytest.raises(ValidationError, match=facts("on_refuted: 'stop' 'sample'")):
        robustness(sampled, clip=[-1, 1], **STOP)


def test_rows_are_equal_where_their_numbers_and_lengths_are() -> None:
    rows = Rows([(1.0, 2.0), (), (3.0,)])
    assert rows == Rows(list(rows))
    assert rows != Rows([(1.0,), (2.0,), (3.0,)]), "other lengths"
    assert rows != Rows([(1.0, 2.0), (), (4.0,)])


def test_the_first_numbers_of_rows_of_any_width() -> None:
    rows = Rows([(1.0, 2.0), (), (3.0,)])
    rows.extend(np.array([[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]))
    rows.append(())
    for start in range(7):
        expected = [row[0] if row else math.nan for row in rows[start:]]
        np.testing.assert_array_equal(rows.firsts(start), expected)
    rows.append((1.0,))  # no view of the numbers is left
    assert rows.firsts(6).tolist() == [1.0]


def test_drawn_starts_are_one_column_of_first_values_without_those_of_a_search() -> None:
    plan = SimpleNamespace(candidates=None, listed=None, is_drawn=lambda test: test % 3 != 1)
    law, expected = OneLaw(cast(ProblemPlan, plan)), AdaptiveOrderTest(starts=1)
    rows, values = Rows(), np.random.default_rng(3).integers(0, 9, (700, 2)) + np.arange(700)[:, None] / 100
    for first, last in ((0, 1), (1, 1), (1, 400), (400, 700)):
        rows.extend(values[first:last])
        found = law.finding([-1] * last, rows)
        for test in range(first, last):
            if test % 3 != 1:
                expected.observe(0, test, float(values[test, 0]))
        assert found == expected.finding()
    assert found.status == "refuted"

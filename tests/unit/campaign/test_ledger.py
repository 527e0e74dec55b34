"""The ledger: what is simulated from the end of one series on, and what is not simulated twice."""

import hashlib
import json
from collections import deque
from pathlib import Path

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.batch import alone
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import Header
from perfbound.schemas.trajectory.trajectory import decode
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import load_system
from tests.campaigns import config, table
from tests.fakes import finished


def test_what_is_in_flight_when_the_last_problem_stops_is_withdrawn_before_its_check(tmp_path: Path) -> None:
    """Else workers simulate what nobody needs, and a rollout that hangs there ends a campaign that needs no result."""
    problem = {**table("test-function-rigorous")["problems"][0], "alpha": 1.0}
    campaign = config("test-function-rigorous", problems=[problem], window=4, spot_check=8, recheck=2)
    header = Header.new(campaign, load_system(campaign.system.name).spec, {"perfbound": "0"})
    journal = Journal.create(tmp_path, header)
    ledger = Ledger(tmp_path, journal)
    with journal.transaction():
        waiting = deque(ledger.outstanding().wanted)
    withdrawn: list[RolloutId] = []
    while not ledger.closing.spot_check:
        rollout = waiting.popleft()
        payload = run_request(alone(ledger.request(rollout)), lambda _: None)
        with ledger.transaction():
            work = ledger.record(rollout, payload, decode(payload), hashlib.sha256(payload).hexdigest())
        withdrawn += work.unwanted
        waiting += work.wanted
    journal.close()
    last = ledger.accounts["maximum"].last_bound
    assert last is not None
    assert last.bound.verdict == "converged"
    assert len(withdrawn) == 3
    assert {each.problem for each in withdrawn} == {"maximum"}
    assert {each.problem for each in waiting} - {"maximum"} == {"spot_check"}


def test_a_follow_up_simulates_no_variant_without_noise_again(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    checks = {"spot_check": 6, "spot_check_followups": 5, "spot_replicates": 2, "recheck": 10_000}
    pair = finished.a_pair("rigorous", **checks).model_dump(mode="json", exclude_none=True)
    # So small a norm that the gap is above its bound at some starts, which are then followed up.
    pair["problems"][1] |= {"rkhs_norm": 0.001, "prior_mean": 0.0}
    stage = finished.play(directory, CampaignConfig.model_validate_json(json.dumps(pair)))
    spot = stage.ledger.series["spot_check"]
    tests = len(spot.observations)
    assert 6 < tests <= 11
    assert spot.counts == {"nominal": 6, "true": 2 * tests}
    assert stage.ledger.closing.recheck is not None
    drawn = stage.ledger.closing.recheck.rollouts
    observed = [
        RolloutId(problem.plan.problem, test, *rollout)
        for problem in stage.ledger.state.problems[:-1]
        for test in range(problem.observed)
        for rollout in problem.plan.rollouts_of(test)
    ]
    assert sorted(drawn) == sorted(observed), "as many as there are: each one once"
    finished.finish(stage, directory)
    checked = verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks
    assert [line.name for line in checked.lines() if line.status == "failed"] == []

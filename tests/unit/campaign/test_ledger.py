"""The ledger: what is simulated from the end of one series on."""

import hashlib
from collections import deque
from pathlib import Path

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.facts import Header
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.trajectory import decode
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import load_system
from tests.campaigns import config, table


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
        payload = run_request(ledger.request(rollout), lambda _: None)
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

"""Large results: decoded beside the loop, with the same outcome as small ones."""

import gc
import hashlib
import queue
import weakref
from pathlib import Path

import pytest

from perfbound.orchestrator.fleet.dispatch.events import Delivered
from perfbound.orchestrator.fleet.link.transport import Result
from perfbound.orchestrator.run import results
from perfbound.orchestrator.run.decoder import Decoded, Decoder
from perfbound.orchestrator.run.doubted_rollouts import Review
from perfbound.orchestrator.run.results import Results
from perfbound.schemas.errors import EvidenceError
from perfbound.schemas.failure import Failure
from perfbound.schemas.link.messages import ResultHeader
from perfbound.schemas.ranges import MAX_FILE_BYTES
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import load_system
from tests.fakes.inmemory import campaign
from tests.fakes.puppets import Stage
from tests.patience import PATIENCE
from tests.unit.run.test_service import LIES, SMALL, Altered, Liar, outcomes

SPEC = load_system("test-function").spec
REQUEST = RolloutRequest(
    campaign="c",
    config_sha256="0" * 64,
    problem="maximum",
    test=0,
    variant="true",
    replicate=0,
    seed=1,
    system=SPEC.name,
    spec_sha256=SPEC.digest,
    options={option.name: option.default for option in SPEC.options},
    x=tuple(parameter.low for parameter in SPEC.parameters),
    horizon=0.0,
)
COLUMNS = tuple(column.name for column in SPEC.columns)


def a_result(at: float, payload: bytes, sha256: str) -> Result:
    header = ResultHeader(rollout=REQUEST.rollout, attempt=1, worker="w", outcome="done", sha256=sha256)
    return Result(at, "w", header, payload)


def test_a_result_is_decoded_once_however_often_it_is_delivered() -> None:
    done: queue.SimpleQueue[Decoded] = queue.SimpleQueue()
    found = Decoder(COLUMNS, done.put)
    assert found.oldest == float("inf")
    payload = run_request(REQUEST, lambda _: None)
    digest = hashlib.sha256(payload).hexdigest()
    for at in (3.0, 4.0, 5.0):
        found.submit(a_result(at, payload, digest), REQUEST)
    decoded = done.get(timeout=PATIENCE)
    assert found.oldest == 3.0, "until the loop has taken it"
    found.finish(decoded)
    assert (found.oldest, done.empty()) == (float("inf"), True)
    assert isinstance(decoded.found, Trajectory)
    found.submit(a_result(6.0, payload, "0" * 64), REQUEST)
    fault = done.get(timeout=PATIENCE).found
    assert isinstance(fault, EvidenceError)
    assert fault.__traceback__ is None


def test_a_file_of_ten_times_what_the_system_declares_is_refused_unread(tmp_path: Path) -> None:
    assert SPEC.largest_file == MAX_FILE_BYTES
    declared = SPEC.model_copy(update={"trajectory_bytes": 100})
    assert (declared.largest_file, declared.digest) == (1000, SPEC.digest)
    stage = Stage(tmp_path, SMALL, 1)
    object.__setattr__(stage.ledger.header, "spec", declared)
    review = Review(stage.ledger, stage.journal, lambda _: None)
    ledger_results = Results(stage.ledger, stage.journal, review, lambda _: None)
    (found,) = ledger_results.take(a_result(1.0, b"x" * 1001, "0" * 64), open_rollouts=())
    assert isinstance(found, Delivered)
    assert found.failure == Failure("system", "the trajectory's file has 1001 bytes, more than the 1000 of a result")
    (found,) = ledger_results.take(a_result(1.0, b"x" * 1000, "0" * 64), open_rollouts=())
    assert isinstance(found, Delivered)
    assert found.failure is None
    stage.journal.close()


def test_the_campaign_is_the_same_when_all_results_are_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calm = campaign(tmp_path / "small", SMALL, workers=2)
    monkeypatch.setattr(results, "LARGE", 0)
    assert campaign(tmp_path / "large", SMALL, workers=2) == calm
    lie, reason = LIES["seed"]
    liar = Liar(lie)
    found = campaign(tmp_path / "lie", SMALL, workers=0, wraps=[lambda uplink: Altered(uplink, result=liar)])
    assert found == calm
    assert sum(reason in outcome for outcome in outcomes(tmp_path / "lie")) == len(liar.lied_about) == 2


def test_a_large_result_that_is_refused_is_held_by_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It stayed until the next full garbage collection, and its bytes kept the next results of its worker out."""
    held: list[weakref.ref[Result]] = []
    submit = Decoder.submit

    def note(decoder: Decoder, result: Result, request: RolloutRequest) -> None:
        held.append(weakref.ref(result))
        submit(decoder, result, request)

    monkeypatch.setattr(Decoder, "submit", note)
    monkeypatch.setattr(results, "LARGE", 0)
    lie, _ = LIES["seed"]
    gc.disable()
    try:
        campaign(tmp_path / "run", SMALL, workers=0, wraps=[lambda uplink: Altered(uplink, result=Liar(lie))])
        assert [each() for each in held] == [None] * len(held)
    finally:
        gc.enable()
    assert held

"""Both ends of the link, without one: restarts, versions, and orchestrators that come and go."""

import pytest

from perfbound.schemas.errors import MessageError, SealError
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.ends import SHOWN, OrchestratorEnd, WorkerEnd, takes_by_certificate
from perfbound.schemas.link.messages import PROTOCOL, Ack, WorkerState, encode_message

RUN = "0123456789abcdef"
SECRET = b"a secret of the tests"
ACK = Ack(rollout="maximum.0.true.0", attempt=1)


def a_state(**changes: object) -> WorkerState:
    state = WorkerState(
        protocol=PROTOCOL, version="1", worker="w", host="h", pid=1, systems={"s": "d" * 64}, state="idle"
    )
    return state.model_copy(update=changes)


def key(orchestrator: OrchestratorEnd) -> str:
    return key_expressions.live_orchestrator(RUN, orchestrator.name)


def joined(*orchestrators: OrchestratorEnd, secret: bytes | None = SECRET) -> WorkerEnd:
    worker = WorkerEnd(secret)
    for each in orchestrators:
        worker.appear(key(each))
    worker.join(RUN, "w")
    return worker


def report(worker: WorkerEnd, orchestrator: OrchestratorEnd) -> WorkerState:
    packet = worker.state(a_state())
    assert packet is not None
    return orchestrator.state("w", packet.payload, packet.attachment)


def test_a_worker_speaks_with_the_orchestrator_that_came_last() -> None:
    """Before the token of the one before is gone, whatever the clocks of the two say."""
    before, after = OrchestratorEnd(SECRET, RUN), OrchestratorEnd(SECRET, RUN)
    worker = joined(after)
    worker.appear(key(before))
    assert report(worker, before) == a_state()
    worker.disappear(key(before))
    assert report(worker, after) == a_state()


def test_a_token_that_comes_back_continues_the_counters() -> None:
    """As after a partition: what was sent before it is no replay of what is sent after it, and the reverse."""
    ours, other = OrchestratorEnd(SECRET, RUN), OrchestratorEnd(SECRET, RUN)
    worker = joined(ours)
    assert report(worker, ours) == a_state()
    said = ours.request("w", ACK)
    assert worker.request(said.payload, said.attachment) == ACK
    for each in (ours, other):
        worker.disappear(key(ours))
        worker.appear(key(each))
    worker.disappear(key(other))
    worker.appear(key(ours))
    assert report(worker, ours) == a_state()
    with pytest.raises(SealError, match="before"):
        worker.request(said.payload, said.attachment)


def test_nothing_is_said_to_nobody() -> None:
    stranger = OrchestratorEnd(b"another secret of a stranger", RUN)
    worker = joined(stranger)
    assert worker.strangers
    assert worker.state(a_state()) is None
    with pytest.raises(SealError, match="no orchestrator is there"):
        worker.request(*stranger.request("w", ACK)[1:])
    worker.disappear(key(stranger))
    assert not worker.strangers


def test_a_worker_of_another_run_has_other_seals() -> None:
    ours = OrchestratorEnd(SECRET, RUN)
    other = OrchestratorEnd(SECRET, "f" * 16)
    worker = joined(ours)
    worker.appear(key_expressions.live_orchestrator("f" * 16, other.name))
    worker.join("f" * 16, "w")
    packet = worker.state(a_state())
    assert packet is not None
    assert key_expressions.run_of(packet.key) == "f" * 16
    with pytest.raises(SealError):
        ours.state("w", packet.payload, packet.attachment)
    assert other.state("w", packet.payload, packet.attachment) == a_state()


def test_a_version_without_seals_is_read_so_that_it_is_refused() -> None:
    """Only where there is no secret: else anyone could have a good worker refused."""
    older = a_state(protocol=1)
    assert OrchestratorEnd(None, RUN).state("w", encode_message(older), None) == older
    with pytest.raises(SealError):
        OrchestratorEnd(None, RUN).state("w", encode_message(a_state()), None)
    with pytest.raises(SealError):
        OrchestratorEnd(SECRET, RUN).state("w", encode_message(older), None)
    with pytest.raises(MessageError):
        OrchestratorEnd(None, RUN).state("w", b"{}", None)


def test_without_a_secret_both_ends_meet() -> None:
    ours = OrchestratorEnd(None, RUN)
    assert report(joined(ours, secret=None), ours) == a_state()
    assert joined(ours).strangers, "with a secret on one side they do not"


def test_a_flood_is_reported_a_few_times() -> None:
    ours = OrchestratorEnd(SECRET, RUN)
    lines = [ours.rejected(SealError("it is forged")) for _ in range(100)]
    assert sum(map(bool, lines)) == SHOWN
    assert lines[SHOWN - 1].endswith("further ones are not reported")


def test_the_name_of_an_orchestrator_says_whether_it_goes_by_certificates() -> None:
    for by_certificate in (True, False):
        ours = OrchestratorEnd(SECRET, RUN, by_certificate=by_certificate)
        assert takes_by_certificate(ours.name) == by_certificate
        assert joined(ours).orchestrators() == [(ours.name, RUN)]

"""A peer that sees every message and may send any, but does not know the secret: nothing of its own is recorded."""

import hashlib
import itertools
import json
import os
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.fleet.children import processes
from perfbound.orchestrator.fleet.children.processes import Fleet
from perfbound.orchestrator.fleet.dispatch import events
from perfbound.orchestrator.fleet.link.transport import Heartbeat, Token
from perfbound.orchestrator.run import outbox, roster, service
from perfbound.orchestrator.run.service import Service
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import Stopped
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.ends import SEAL, SHOWN, OrchestratorEnd, Packet, WorkerEnd
from perfbound.schemas.link.messages import (
    Ack,
    Assign,
    Cancel,
    Refuse,
    Request,
    ResultHeader,
    WorkerState,
    decode_header,
    decode_request,
    encode_message,
)
from perfbound.schemas.stop_signals import END_FAMILY
from perfbound.workers.systems import load_system
from tests.campaigns import UNCHECKED
from tests.fakes.inmemory import (
    InMemoryTransport,
    InMemoryUplink,
    Log,
    Network,
    begin,
    campaign,
    hurry,
    run_of,
    serve,
    working,
)
from tests.fakes.puppets import worker_state

PRESET = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"
STRANGER = b"what a stranger takes for the secret"
LOCAL_PID = os.getpid()


def a_config() -> CampaignConfig:
    return parse_campaign(
        PRESET.read_bytes(), "test", resolution=11, max_tests=6, replicates=2, max_attempts=3, **UNCHECKED
    )


ROLLOUTS = 12


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch, tick=0.02)


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> str:
    return campaign(tmp_path_factory.mktemp("calm") / "run", a_config())


class Tapped(Network):
    """A network on which everything is seen; what `answer` returns for a message is put behind it."""

    def __init__(self, answer: Callable[[Packet], Iterable[Packet]] = lambda _: ()) -> None:
        self.seen: list[Packet] = []
        self.hostile = 0
        self._answer = answer
        super().__init__()

    def put(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        packet = Packet(key, payload, attachment or b"")
        self.seen.append(packet)
        super().put(*packet)
        for forged in self._answer(packet):
            self.hostile += 1
            super().put(*forged)


def recorded(directory: Path) -> list[tuple[str, str]]:
    """Return outcome and worker of every attempt."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute("SELECT outcome, worker FROM outcomes ORDER BY rowid").fetchall()


def beset(directory: Path, network: Tapped, calm: str) -> None:
    """Run the campaign with two honest workers: it ends as without the peer, and hardly says a word about it."""
    log = Log()
    if not directory.exists():
        begin(directory, a_config())
    with network, working(network, run_of(directory), [lambda uplink: uplink] * 2) as refused:
        assert serve(directory, network, log) == calm
        assert refused == []
    assert network.hostile > ROLLOUTS
    found = recorded(directory)
    assert [outcome for outcome, _ in found] == ["recorded"] * ROLLOUTS
    assert all(worker.startswith("worker-") for _, worker in found)
    assert len(log.lines) <= SHOWN + 2, log.lines


# Forgeries

ALL = (b"", bytes(SEAL), b"no seal at all")


def requests(packet: Packet) -> Iterable[Packet]:
    """To the worker that gets a message: cancel it, acknowledge what was never delivered, send the worker away."""
    _, run, kind, worker, *_ = packet.key.split("/")
    if kind != "request":
        return
    message = decode_request(packet.payload)
    orders: list[Request] = [Refuse(reason="go away")]
    if isinstance(message, Assign):
        rollout, attempt = message.request.rollout, message.attempt
        orders += [kind(rollout=rollout, attempt=attempt) for kind in (Cancel, Ack)]
        orders += [message.model_copy(update={"secret": "0" * 64, "attempt": attempt + 1})]
    for order in orders:
        payload = encode_message(order)
        for attachment in (*ALL, packet.attachment):
            yield Packet(packet.key, payload, attachment)
        yield OrchestratorEnd(STRANGER, run).request(worker, order)


def results(packet: Packet) -> Iterable[Packet]:
    """In the name of the worker that gets an assignment: a failure, and a result of another start."""
    _, run, kind, worker, *_ = packet.key.split("/")
    if kind != "request" or not isinstance(message := decode_request(packet.payload), Assign):
        return
    rollout, attempt = message.request.rollout, message.attempt
    failed = ResultHeader(
        rollout=rollout, attempt=attempt, worker=worker, outcome="failed", error="forged", kind="system"
    )
    digest = hashlib.sha256(b"forged").hexdigest()
    done = ResultHeader(rollout=rollout, attempt=attempt, worker=worker, outcome="done", sha256=digest, proof="0" * 64)
    key = key_expressions.result_key(run, worker, rollout, attempt)
    for header in (failed, done):
        for seal in (*ALL, packet.attachment):
            yield Packet(key, b"forged", seal + encode_message(header))
        yield Packet(key, b"forged", encode_message(header))
        yield sealed_by_a_stranger(run, worker).result(header, b"forged") or packet


def states(packet: Packet) -> Iterable[Packet]:
    """In the name of the worker that reports: another version, another attempt, the process id of this process."""
    _, run, kind, worker, *_ = packet.key.split("/")
    if kind != "up" or key_expressions.last(packet.key) != "state":
        return
    said = json.loads(packet.payload)
    changes: list[dict[str, Any]] = [
        {"protocol": 1},
        {"version": "0.0.1"},
        {"systems": {}},
        {"pid": LOCAL_PID},
        {"state": "busy", "rollout": "maximum.0.true.0", "attempt": 3, "progress": 10**6},
    ]
    for change in changes:
        payload = json.dumps(said | change).encode()
        for attachment in (*ALL, packet.attachment):
            yield Packet(packet.key, payload, attachment)
        state = WorkerState.model_validate_json(payload)
        yield sealed_by_a_stranger(run, worker).state(state) or packet


def sealed_by_a_stranger(run: str, worker: str) -> WorkerEnd:
    end = WorkerEnd(STRANGER)
    end.appear(key_expressions.live_orchestrator(run, OrchestratorEnd(STRANGER, run).name))
    end.join(run, worker)
    return end


def echoes(packet: Packet) -> Iterable[Packet]:
    """Every message again, also as one of another worker, attempt or direction."""
    _, run, kind, worker, *_ = packet.key.split("/")
    yield packet
    yield packet._replace(key=packet.key.replace(worker, f"{worker}0"))
    if kind == "up" and key_expressions.last(packet.key) != "state":
        header = decode_header(packet.attachment[SEAL:])
        changed = header.model_copy(update={"attempt": header.attempt + 1})
        yield packet._replace(attachment=packet.attachment[:SEAL] + encode_message(changed))
        yield packet._replace(payload=packet.payload + b"x")
        yield packet._replace(key=key_expressions.state_key(run, worker))
    if kind == "request":
        yield packet._replace(key=key_expressions.state_key(run, worker))


@pytest.mark.parametrize("forge", [requests, results, states, echoes])
def test_what_a_peer_forges_changes_nothing(
    tmp_path: Path, calm: str, forge: Callable[[Packet], Iterable[Packet]]
) -> None:
    beset(tmp_path / "run", Tapped(forge), calm)


def test_tokens_of_a_peer_change_nothing(tmp_path: Path, calm: str) -> None:
    """It announces workers, and orchestrators of this run and of others that are older than the true one."""

    def tokens(packet: Packet) -> Iterable[Packet]:
        for run in (key_expressions.run_of(packet.key), "0" * 16):
            for secret in (STRANGER, b""):
                key = key_expressions.live_orchestrator(run, "0" + OrchestratorEnd(secret, run).name[1:])
                network.tell(partial(network.announce, key, alive=True))
        for transport in network.transports.values():
            network.tell(partial(transport.hear, key_expressions.fresh_id("ghost"), alive=True))
        return requests(packet)

    network = Tapped(tokens)
    beset(tmp_path / "run", network, calm)


def test_replays_of_an_earlier_campaign_change_nothing(tmp_path: Path, calm: str) -> None:
    """Of the same file and the same secret, under the keys of the campaign that runs."""
    before = Tapped()
    begin(tmp_path / "before", a_config())
    with before, working(before, run_of(tmp_path / "before"), [lambda uplink: uplink]):
        assert serve(tmp_path / "before", before, Log()) == calm
    begin(tmp_path / "run", a_config())
    run, old = run_of(tmp_path / "run"), run_of(tmp_path / "before")
    earlier = itertools.cycle(before.seen)

    def replay(packet: Packet) -> Iterable[Packet]:
        worker = packet.key.split("/")[3]
        for key, payload, attachment in itertools.islice(earlier, 20):
            yield Packet(key.replace(old, run), payload, attachment)
            yield Packet(key.replace(old, run).replace(key.split("/")[3], worker), payload, attachment)

    beset(tmp_path / "run", Tapped(replay), calm)


class Unproved:
    """An uplink that knows the secret of the user, but sends failures that no assignment proves."""

    def __init__(self, inner: InMemoryUplink) -> None:
        self._inner = inner
        self.orchestrators, self.join = inner.orchestrators, inner.join
        self.leave, self.report = inner.leave, inner.report

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        forged = {"outcome": "failed", "kind": "system", "error": "forged", "sha256": ""}
        for proof in ("", "0" * 64, header.proof):
            self._inner.deliver(header.model_copy(update={**forged, "proof": proof}), b"")
        self._inner.deliver(header, payload)


def test_a_result_that_no_assignment_proves_is_not_recorded(tmp_path: Path, calm: str) -> None:
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    with Network() as network, working(network, run_of(directory), [Unproved] * 2):
        assert serve(directory, network, log) == calm
    assert [outcome for outcome, _ in recorded(directory)] == ["recorded"] * ROLLOUTS
    assert {line.partition(" of ")[2].partition("-")[0] for line in log.lines} == {"worker"}
    assert all(line.endswith("no assignment proves its result") for line in log.lines)
    assert not (directory / outbox.KEY).exists()


def test_without_the_key_of_the_assignments_their_rollouts_are_simulated_again(
    tmp_path: Path, calm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "TICK", 0.001)
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        with pytest.raises(Stopped):
            serve(directory, network, log, stop=lambda seen: seen.recorded >= 3)
        (directory / outbox.KEY).unlink()
        assert serve(directory, network, log, resumed=True) == calm


def test_workers_beyond_the_most_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roster, "LIVING", 3)
    monkeypatch.setattr(service, "LIVING", 3)
    begin(tmp_path / "run", a_config())
    log = Log()
    with closing(Journal.open(tmp_path / "run")) as journal, Network() as network:
        server = Service(
            Ledger(tmp_path / "run", journal), journal, InMemoryTransport(network), None, [log], resumed=False
        )
        for name in (f"w{number}" for number in range(10)):
            server._take(Token(0.0, name, alive=True))
        assert len(server._roster.records) == 3
    assert log.lines == [
        "worker w3, and those that come after it, get no work: 3 workers are there, the most of one campaign; end "
        "them, or start them with --run ID for another campaign"
    ]


# Local workers


@pytest.mark.integration
def test_a_process_that_a_message_claims_is_not_ended(tmp_path: Path) -> None:
    """A worker that hangs, and that names this host and the process of a local worker, which is its host's own."""
    begin(tmp_path / "run", a_config())
    fleet = Fleet(0, (), "")
    own = subprocess.Popen(["sleep", "1000"])
    fleet._children.append(processes._Child("local-1-0123abcd", own, time.monotonic()))
    with closing(Journal.open(tmp_path / "run")) as journal, Network() as network:
        server = Service(
            Ledger(tmp_path / "run", journal), journal, InMemoryTransport(network), fleet, [], resumed=False
        )
        spec = load_system("test-function").spec
        state = worker_state("local-1-0123abcd", spec, host=os.uname().nodename, pid=own.pid)
        server._take(Token(0.0, "stranger-1", alive=True))
        server._take(Heartbeat(0.0, "stranger-1", state))
        assert server._roster.admitted("stranger-1") == state
        server._act(events.GiveUp("stranger-1"))
        assert own.poll() is None
        server._act(events.GiveUp("local-1-0123abcd"))
        assert own.wait() == -END_FAMILY, "its guardian would end it"
    fleet.stop()

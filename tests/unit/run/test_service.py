"""A whole campaign in one process: the certificate does not depend on timing, and no bad message is accepted."""

import asyncio
import copy
import hashlib
import json
import random
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.fleet.link.transport import Heartbeat, Result, Sink, Token
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.lines import EACH
from perfbound.orchestrator.run.service import RunStatus, Service
from perfbound.orchestrator.store import files as evidence
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import PerfboundError, SimulationError, Stopped, UnknownSystemError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.link.messages import (
    MAX_RESULT,
    PROTOCOL,
    Assign,
    Cancel,
    Request,
    ResultHeader,
    RunFinished,
    WorkerState,
)
from perfbound.schemas.link.seal import result_proof
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from perfbound.workers import worker as module
from perfbound.workers.simulate import requested_system, run_request, run_request_on
from perfbound.workers.systems import load_system
from perfbound.workers.systems.base import Cancelled, SystemUnderTest
from perfbound.workers.transport import Receiver
from perfbound.workers.worker import WorkerProcess
from tests.campaigns import UNCHECKED
from tests.facts import facts, says
from tests.fakes.inmemory import (
    Faults,
    InMemoryTransport,
    InMemoryUplink,
    Log,
    Network,
    Wrap,
    begin,
    campaign,
    hurry,
    run_of,
    serve,
    working,
)
from tests.fakes.puppets import worker_state
from tests.faults.verdict import REPRODUCIBLE, without

PRESET = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"
ATTEMPTS = 3


def a_config(**changes: Any) -> CampaignConfig:
    base = {"resolution": 11, "max_tests": 12, "replicates": 3, "max_attempts": ATTEMPTS, **UNCHECKED}
    return parse_campaign(PRESET.read_bytes(), "test", **{**base, **changes})


LOSSY = a_config(max_attempts=1000)
"""Under loss a rollout may fail often without being poison."""
SMALL = a_config(max_tests=4, replicates=2)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything as it is, in a tenth of the time."""
    hurry(monkeypatch, tick=0.02)


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Callable[[CampaignConfig], str]:
    """The certificate of a campaign without trouble, with one worker."""
    known: dict[str, str] = {}

    def certificate(config: CampaignConfig) -> str:
        if config.digest not in known:
            known[config.digest] = campaign(tmp_path_factory.mktemp("calm") / "run", config)
        return known[config.digest]

    return certificate


Calm = Callable[[CampaignConfig], str]


def outcomes(directory: Path) -> list[str]:
    return [outcome for outcome, _ in kinds(directory)]


def kinds(directory: Path) -> list[tuple[str, str | None]]:
    """Return outcome and kind of failure of every attempt."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute("SELECT outcome, kind FROM outcomes ORDER BY rowid").fetchall()


def check_evidence(directory: Path, rollouts: int = 36) -> None:
    """Every rollout is there once, under its digest."""
    lines = (directory / files.MANIFEST).read_text().splitlines()
    assert len(lines) == len(set(lines)) == rollouts
    for line in lines:
        sha256, path = line.split("  ")
        evidence.read_evidence(directory, path, sha256)
    assert sorted(path.name for path in directory.rglob("*.mcap")) == sorted(Path(line).name for line in lines)


# Random timing


@pytest.mark.parametrize("workers", [2, 3])
def test_the_number_of_workers_changes_nothing(tmp_path: Path, calm: Calm, workers: int) -> None:
    assert campaign(tmp_path / "run", a_config(), workers=workers) == calm(a_config())
    check_evidence(tmp_path / "run")
    assert outcomes(tmp_path / "run") == ["recorded"] * 36


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(3))
def test_a_bad_network_changes_nothing(tmp_path: Path, calm: Calm, seed: int) -> None:
    faults = Faults(seed, loss=0.15, duplication=0.3, delay=0.05)
    assert campaign(tmp_path / "run", LOSSY, workers=2, faults=faults) == calm(LOSSY)
    check_evidence(tmp_path / "run")


def _has_recorded(limit: int, seen: RunStatus) -> bool:
    return seen.recorded >= limit


@pytest.mark.rest
@pytest.mark.parametrize("faults", [Faults(), Faults(7, loss=0.1, duplication=0.3, delay=0.03)])
def test_stops_and_resumes_change_nothing(
    tmp_path: Path, calm: Calm, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "TICK", 0.001)  # a stop is asked for at ticks: as often as there are messages
    directory, rng, stops = tmp_path / "run", random.Random(3), 0
    begin(directory, LOSSY)
    with Network(faults) as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        while True:
            stop = partial(_has_recorded, rng.randint(0, 9))
            try:
                found = serve(directory, network, Log(), stop=stop, resumed=stops > 0)
                break
            except Stopped:
                stops += 1
    assert stops >= 3
    assert found == calm(LOSSY)
    check_evidence(directory)


def _once(condition: Callable[[RunStatus], bool]) -> Callable[[RunStatus], bool]:
    """True at the first moment of `condition` only: one signal."""
    told: list[bool] = []

    def now(seen: RunStatus) -> bool:
        if told or not condition(seen):
            return False
        told.append(True)
        return True

    return now


def test_draining_finishes_what_is_under_way_and_begins_nothing(
    tmp_path: Path, calm: Calm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "TICK", 0.001)
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 3):
        busy = _once(lambda seen: seen.recorded >= 5 and bool({"sent", "busy"} & set(seen.workers.values())))
        with pytest.raises(Stopped):
            serve(directory, network, log, stop=busy, drain=True)
        assert "draining" in log.lines[-1]
        with closing(sqlite3.connect(directory / DATABASE)) as connection:
            # The first result of a session is doubted, and simulated once more.
            doubted = "(SELECT rollout, attempt FROM opinions)"
            query = f"SELECT count(*) FROM attempts WHERE (rollout, attempt) NOT IN {doubted}"
            begun = connection.execute(query).fetchone()[0]
        assert outcomes(directory) == ["recorded"] * begun
        assert 5 < begun < 36
        assert serve(directory, network, Log(), resumed=True) == calm(a_config())


def test_only_a_second_signal_ends_the_wait_for_what_is_under_way(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    looks: list[RunStatus] = []
    begin(directory, a_config(hung_after=30.0))

    def later(seen: RunStatus) -> bool:
        """One signal when a worker is at work, and one 20 statuses later."""
        looks.extend([seen] if looks or {"sent", "busy"} & set(seen.workers.values()) else [])
        return len(looks) in (1, 21)

    with Network() as network, working(network, run_of(directory), [_muted]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=later, drain=True)
    assert len(looks) >= 21
    assert outcomes(directory) == []


def _muted(uplink: InMemoryUplink) -> InMemoryUplink:
    uplink.deliver = lambda header, payload: None  # type: ignore[method-assign]
    return uplink


def test_a_rollback_leaves_nothing_behind(tmp_path: Path, calm: Calm, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full in the middle of a turn; the next orchestrator resumes."""
    directory = tmp_path / "run"
    begin(directory, a_config())
    writes = iter(range(10_000))
    real = evidence.Batch.write

    def write(batch: evidence.Batch, path: Path, data: bytes) -> None:
        if next(writes) == 17:
            raise OSError(28, "No space left on device")
        real(batch, path, data)

    monkeypatch.setattr(evidence.Batch, "write", write)
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink]):
        with pytest.raises(OSError, match="No space left"):
            serve(directory, network, Log())
        assert serve(directory, network, Log(), resumed=True) == calm(a_config())
    check_evidence(directory)


def stop_and_spoil(directory: Path) -> None:
    """Stop a campaign after ten rollouts and spoil three of the newest files, as a power cut may."""
    begin(directory, a_config())
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=partial(_has_recorded, 10))
    newest = sorted(directory.rglob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)[-3:]
    newest[0].unlink()
    newest[1].write_bytes(newest[1].read_bytes()[:100])
    newest[2].write_bytes(bytes(newest[2].stat().st_size))


def test_files_that_a_power_cut_spoiled_are_simulated_again(tmp_path: Path, calm: Calm) -> None:
    directory = tmp_path / "run"
    stop_and_spoil(directory)
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        assert serve(directory, network, Log(), resumed=True) == calm(a_config())
    check_evidence(directory)
    assert outcomes(directory).count("restored") == 3
    assert outcomes(directory).count("recorded") == 36


def test_a_file_that_comes_out_different_is_not_put_back(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    stop_and_spoil(directory)

    def altered(header: ResultHeader, payload: bytes) -> tuple[ResultHeader, bytes]:
        return with_digest(header, rewritten(payload, COLUMNS))

    liar: Wrap = partial(Altered, result=altered)
    with (
        Network() as network,
        working(network, run_of(directory), [liar]),
        pytest.raises(PerfboundError, match=facts("other file copy")),
    ):
        serve(directory, network, Log(), resumed=True)
    assert "restored" not in outcomes(directory)


# Untrusted workers


class Altered:
    """An uplink that changes the messages of its worker, and proves what it has changed."""

    def __init__(
        self,
        inner: InMemoryUplink,
        state: Callable[[WorkerState], WorkerState] = lambda state: state,
        result: Callable[[ResultHeader, bytes], tuple[ResultHeader, bytes]] = lambda header, payload: (header, payload),
    ) -> None:
        self._inner, self._state, self._result = inner, state, result
        self._secrets: dict[tuple[str, int], str] = {}

    def orchestrators(self) -> list[tuple[str, str]]:
        return self._inner.orchestrators()

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        def listen(message: Request) -> None:
            if isinstance(message, Assign):
                self._secrets[message.request.rollout, message.attempt] = message.secret
            receive(message)

        self._inner.join(run, worker, listen)

    def leave(self) -> None:
        self._inner.leave()

    def report(self, state: WorkerState) -> None:
        self._inner.report(self._state(state))

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        secret = self._secrets[header.rollout, header.attempt]
        header, payload = self._result(header, payload)
        self._inner.deliver(proved(secret, header), payload)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": "0.0.1"}, "install the same version on both"),
        ({"protocol": PROTOCOL + 1}, "install the same version on both"),
        ({"systems": {}}, "has no system 'test-function'"),
        ({"platform": "other-7-glibc-2.5"}, "other-7-glibc-2.5 campaign's"),
        ({"platform": ""}, "platform is unknown"),
        ({"systems": {"test-function": "0" * 64}, "parts": {}}, "other files"),
    ],
)
def test_a_worker_that_does_not_fit_is_refused(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    misfit: Wrap = lambda uplink: Altered(uplink, state=lambda state: state.model_copy(update=change))  # noqa: E731
    with Network() as network, working(network, run_of(directory), [misfit]) as refused:
        with pytest.raises(Stopped) as stopped:
            serve(directory, network, log, stop=lambda seen: bool(refused))
        assert stopped.value.signal == 2
    assert len(refused) == 1
    assert says(refused[0], reason)
    assert "\n" not in refused[0]
    (line,) = log.lines
    assert line.startswith("refused worker worker-0-")
    assert line.endswith(refused[0])
    assert outcomes(directory) == []


def proved(secret: str, header: ResultHeader) -> ResultHeader:
    return header.model_copy(update={"proof": result_proof(secret, header)})


def with_digest(header: ResultHeader, payload: bytes) -> tuple[ResultHeader, bytes]:
    return header.model_copy(update={"sha256": hashlib.sha256(payload).hexdigest()}), payload


def rewritten(
    payload: bytes,
    columns: tuple[str, ...],
    *,
    time: float = 0.0,
    metadata: dict[str, str] | None = None,
    **request: Any,
) -> bytes:
    """The file of a worker that changes columns, metadata or request, with true checksums."""
    file = read_mcap(payload)
    trajectory = Trajectory(columns, np.array([[time, *[0.5] * (len(columns) - 1)]]))
    changed = {**file.request, **request}
    record = {name: text for name, text in file.metadata.items() if name != "columns"} | (metadata or {})
    return encode(trajectory, request=changed, metadata=record, units=dict.fromkeys(columns, "1"))


def with_nan(payload: bytes) -> bytes:
    """The file of a worker that checks no number, with true checksums."""
    file = read_mcap(payload)
    trajectory = copy.copy(file.trajectory)
    object.__setattr__(trajectory, "samples", trajectory.samples * np.nan)
    units = dict.fromkeys(trajectory.columns, "1")
    record = {name: text for name, text in file.metadata.items() if name != "columns"}
    return encode(trajectory, request=file.request, metadata=record, units=units)


COLUMNS = ("t", "value")
Lie = Callable[[bytes, bytes], tuple[bytes, bool]]
"""(first payload, this payload) -> (what is sent, whether the header has its digest)."""
LIES: dict[str, tuple[Lie, str]] = {
    "digest": (lambda _, mine: (mine + b"\0", False), "does not have the sha256"),
    "empty": (lambda _, mine: (b"", True), "not a trajectory"),
    "noise": (lambda _, mine: (b"noise" * 99, True), "not a trajectory"),
    "cut": (lambda _, mine: (mine[:-1], True), "not a trajectory"),
    "columns": (lambda _, mine: (rewritten(mine, ("t", "other")), True), "has the columns t, other"),
    "order": (lambda _, mine: (rewritten(mine, ("t", "value", "b")), True), "has the columns t, value, b"),
    "another": (lambda first, _: (first, True), "simulated for another request (other "),
    "seed": (lambda _, mine: (rewritten(mine, COLUMNS, seed=1), True), "simulated for another request (other seed)"),
    "start": (lambda _, mine: (rewritten(mine, COLUMNS, x=[0.25, 0.0]), True), "another request (other x)"),
    "kind": (lambda _, mine: (rewritten(mine, COLUMNS, replicate=False), True), "another request (other "),
    "metadata": (
        lambda _, mine: (rewritten(mine, COLUMNS, metadata={"seed": "1"}), True),
        "metadata of the trajectory",
    ),
    "time": (
        lambda _, mine: (rewritten(mine, COLUMNS, time=1.0), True),
        "the first row is at t = 1 s, and 0 s is requested",
    ),
    "nan": (lambda _, mine: (with_nan(mine), True), "not a usable trajectory: samples are not finite: "),
    "more": (lambda _, mine: (rewritten(mine, COLUMNS, comment=""), True), "another request (other comment)"),
}
OF_SYSTEM = {"columns", "order", "time", "nan"}
"""Lies that are whole files with an unusable trajectory."""


class Liar:
    """Sends false results for its first attempts at two rollouts, and true ones before and afterwards."""

    def __init__(self, lie: Lie) -> None:
        self._lie = lie
        self._first: bytes | None = None
        self._sent: dict[tuple[str, int], tuple[ResultHeader, bytes]] = {}
        self.lied_about: set[str] = set()

    def __call__(self, header: ResultHeader, payload: bytes) -> tuple[ResultHeader, bytes]:
        key = (header.rollout, header.attempt)
        if key not in self._sent:  # a repeated delivery has the same content
            self._sent[key] = self._said(header, payload)
        return self._sent[key]

    def _said(self, header: ResultHeader, payload: bytes) -> tuple[ResultHeader, bytes]:
        if self._first is None:
            self._first = payload
            return header, payload
        if header.attempt > 1 or len(self.lied_about) == 2:
            return header, payload
        self.lied_about.add(header.rollout)
        sent, digest = self._lie(self._first, payload)
        return with_digest(header, sent) if digest else (header, sent)


@pytest.mark.parametrize("kind", LIES)
def test_a_lie_is_a_failed_attempt_and_the_rollout_is_tried_again(
    tmp_path: Path, calm: Calm, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    lie, reason = LIES[kind]
    liar, log = Liar(lie), Log()
    wrap: Wrap = lambda uplink: Altered(uplink, result=liar)  # noqa: E731
    config = SMALL
    found = campaign(tmp_path / "run", config, workers=0, wraps=[wrap], log=log)
    if kind in OF_SYSTEM:  # a failure that does not repeat shows in one assumption, and in no number
        assert json.loads(found) != json.loads(calm(config))
        assert without(found.encode(), REPRODUCIBLE) == without(calm(config).encode(), REPRODUCIBLE)
    else:
        assert found == calm(config)
    # On a busy machine the hurried clocks may lose the worker for a moment, and a parcel may come twice.
    failed = [kind_of for outcome, kind_of in kinds(tmp_path / "run") if reason in outcome]
    told = {line for line in log.lines if reason in line}
    assert len(failed) == len(liar.lied_about) == len(told) == 2
    assert set(failed) == {"system" if kind in OF_SYSTEM else "infrastructure"}
    assert read.irreproducible(tmp_path / "run") == (2 if kind in OF_SYSTEM else 0)
    assert all("\n" not in line and len(line) < 500 for line in log.lines)
    check_evidence(tmp_path / "run", 8)


class Flood(Altered):
    """An uplink that adds, to each heartbeat, failures of attempts that nobody made, with long texts, and garbage."""

    sent = 0

    def report(self, state: WorkerState) -> None:
        self._inner.report(state)
        for number in range(20):
            self.sent += 1
            claim = ResultHeader(rollout="maximum.0.true.0", attempt=1 + self.sent, worker="x", outcome="failed")
            error = f"\x1b[2J {self.sent}" + "x" * 20_000
            forged = claim.model_copy(update={"kind": "system", "error": error})
            self._inner.deliver(forged, b"")
            self._inner.deliver(forged.model_copy(update={"rollout": "m" * 20_000, "attempt": number}), b"")


def test_a_flood_of_failures_and_garbage_is_neither_recorded_nor_printed(tmp_path: Path, calm: Calm) -> None:
    log, floods = Log(), list[Flood]()

    def wrap(uplink: InMemoryUplink) -> Flood:
        floods.append(Flood(uplink))
        return floods[-1]

    found = campaign(tmp_path / "run", a_config(), workers=1, wraps=[wrap], log=log)
    assert found == calm(a_config())
    assert floods[0].sent > 20
    assert set(outcomes(tmp_path / "run")) == {"recorded"}
    assert 0 < len(log.lines) <= EACH
    assert all(len(line) < 500 and line.isprintable() for line in log.lines)


# Systems that fail


def failing(fault: Callable[[], bytes]) -> Callable[..., bytes]:
    def never(system: object, request: RolloutRequest, progress: object) -> bytes:
        return fault()

    return never


def raising(error: BaseException) -> Callable[[], bytes]:
    def fault() -> bytes:
        raise error

    return fault


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (raising(RuntimeError("boom")), "RuntimeError: boom"),
        (raising(SimulationError("the Segway fell")), "the Segway fell"),
        (raising(SimulationError()), "The rollout has no usable trajectory"),
        (raising(OSError("no file b\udce9ta")), "OSError: no file b\\udce9ta"),
        (lambda: b"x" * (MAX_RESULT + 1), f"{MAX_RESULT + 1} bytes, more than the {MAX_RESULT} of a result"),
    ],
)
def test_a_system_that_always_fails_ends_the_campaign_with_its_story(
    tmp_path: Path, calm: Calm, monkeypatch: pytest.MonkeyPatch, fault: Callable[[], bytes], expected: str
) -> None:
    directory, config, log = tmp_path / "run", SMALL, Log()
    begin(directory, config)
    monkeypatch.setattr(module, "run_on", failing(fault))
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink]):
        with pytest.raises(PerfboundError) as end:
            serve(directory, network, log)
        assert len(log.lines) == 1, "told once"
        assert "failed 2 times" in str(end.value), "on the only worker"
        assert str(end.value).count(expected) == 1, "each reason once"
        assert all(f"attempt {number} on " in str(end.value) for number in (1, 2))
        assert "then resume" in str(end.value)
        assert not (directory / files.CERTIFICATE).exists()
        assert [kind for outcome, kind in kinds(directory) if expected in outcome] == ["system"] * 2
        assert outcomes(directory).count("recorded") == 0
        assert read.irreproducible(directory) == 0, "a rollout without a result was not selected"
        monkeypatch.setattr(module, "run_on", run_request_on)
        found = serve(directory, network, Log(), resumed=True)
    assert without(found.encode(), REPRODUCIBLE) == without(calm(config).encode(), REPRODUCIBLE)
    check_evidence(directory, 8)
    assert read.irreproducible(directory) >= 1, "the resume repeats a rollout that had failed with its seed"


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (raising(RuntimeError("recorded")), "RuntimeError: recorded"),
        (raising(SimulationError("recorded")), "failed: recorded"),
        (raising(SystemExit("no licence")), "SystemExit: no licence"),
        (raising(asyncio.CancelledError("of a loop")), "CancelledError: of a loop"),
    ],
)
def test_a_system_that_fails_once_is_irreproducible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Callable[[], bytes], expected: str
) -> None:
    directory, log, failed = tmp_path / "run", Log(), list[str]()

    def once(system: SystemUnderTest, request: RolloutRequest, progress: Callable[[int], None]) -> bytes:
        if request.test == 2 and not failed:
            failed.append(request.rollout)
            fault()
        return run_request_on(system, request, progress)

    monkeypatch.setattr(module, "run_on", once)
    campaign(directory, SMALL, workers=2, log=log)
    check_evidence(directory, 8)
    (reason,) = [reason for reason, kind in kinds(directory) if kind == "system"]
    assert reason.partition(" (test_service.py, line ")[0] == expected
    assert outcomes(directory).count("recorded") == 8
    assert read.irreproducible(directory) == 1
    said = [line for line in log.lines if line.startswith(failed[0]) and "system failure: " in line]
    assert len(said) == 1


@pytest.mark.parametrize("fault", [UnknownSystemError("not installed"), SimulationError("another build")])
def test_a_worker_without_the_system_is_a_failure_of_the_infrastructure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: PerfboundError
) -> None:
    directory, failed = tmp_path / "run", list[str]()

    def once(request: RolloutRequest) -> SystemUnderTest:
        if not failed:
            failed.append(request.rollout)
            raise fault
        return requested_system(request)

    monkeypatch.setattr(module, "requested_system", once)
    campaign(directory, SMALL)
    assert (str(fault), "infrastructure") in kinds(directory)
    assert read.irreproducible(directory) == 0


# A busy orchestrator


class Clock:
    """The time of the service, which a test may move."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead


class Puppets:
    """Three workers without threads: two answer at once, `slow` and the first one after the long turn on command."""

    endpoint = "memory/puppets:0"

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._sink: Sink = lambda _: None
        self.held: Assign | None = None
        self.holds = True
        self.late: tuple[str, Assign] | None = None
        self.answered = False

    def start(self, run: str, sink: Sink) -> None:
        self._sink = sink
        for name in ("a", "b", "slow"):
            sink(Token(self._clock.monotonic(), name, alive=True))
            self.beat(name, None, 0)

    def send(self, worker: str, message: Request) -> None:
        if not isinstance(message, Assign):
            return
        if worker == "slow" and self.holds:
            self.held = message
            self.beat(worker, message, 1)
        elif not self.holds and self.late is None:
            self.late = (worker, message)
        else:
            self.finish(worker, message)

    def tick(self, _: RunStatus) -> None:
        """The clock has been looked at: the late one answers."""
        if self.late is not None and not self.answered:
            self.answered = True
            self.finish(*self.late)

    def beat(self, worker: str, assign: Assign | None, progress: int) -> None:
        state = worker_state(worker, load_system("test-function").spec, assign, progress)
        self._sink(Heartbeat(self._clock.monotonic(), worker, state))

    def finish(self, worker: str, assign: Assign) -> None:
        payload = run_request(assign.request, lambda _: None)
        header = ResultHeader(rollout=assign.request.rollout, attempt=assign.attempt, worker=worker, outcome="done")
        header, payload = with_digest(header, payload)
        self._sink(Result(self._clock.monotonic(), worker, proved(assign.secret, header), payload))


def test_a_busy_orchestrator_takes_no_worker_for_hung(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One result takes 30 s to handle; what waits in the inbox since, and what is assigned then, is not late."""
    directory, clock = tmp_path / "run", Clock()
    begin(directory, a_config(replicates=8, max_tests=3))
    puppets, real = Puppets(clock), evidence.Batch.write
    log = Log(puppets.tick)

    def write(batch: evidence.Batch, path: Path, data: bytes) -> None:
        if puppets.held is not None and puppets.holds:
            clock.ahead += 15.0
            puppets.beat("slow", puppets.held, 2)
            clock.ahead += 15.0
            puppets.holds = False
            puppets.finish("slow", puppets.held)
        real(batch, path, data)

    monkeypatch.setattr(evidence.Batch, "write", write)
    monkeypatch.setattr(service, "time", clock)
    journal = Journal.open(directory)
    ledger = Ledger(directory, journal)
    server = Service(ledger, journal, puppets, None, [log], resumed=False)
    puppets.start(journal.header.run, server.inbox.put)
    server.run()
    journal.close()
    assert puppets.answered
    assert log.lines == []
    assert outcomes(directory) == ["recorded"] * 24


# The worker alone


class Deaf:
    """An uplink that notes what the worker reports."""

    def __init__(self) -> None:
        self.states: list[WorkerState] = []
        self.results: list[ResultHeader] = []

    def orchestrators(self) -> list[tuple[str, str]]:
        return []

    def join(self, run: str, worker: str, receive: Receiver) -> None: ...

    def leave(self) -> None: ...

    def report(self, state: WorkerState) -> None:
        self.states.append(state)

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        self.results.append(header)


def an_assign(test: int, attempt: int = 1) -> Assign:
    request = RolloutRequest(
        campaign="c",
        config_sha256="0" * 64,
        problem="maximum",
        test=test,
        variant="true",
        replicate=0,
        seed=0,
        system="test-function",
        spec_sha256=load_system("test-function").spec.digest,
        x=(0.0, 0.0),
        horizon=0.0,
    )
    return Assign(attempt=attempt, secret="0" * 64, request=request)


def served(worker: WorkerProcess, uplink: Deaf, results: int) -> None:
    """Let the worker work until it has delivered so much."""
    worker.serve(lambda _: len(uplink.results) >= results)


def test_the_progress_of_one_rollout_is_not_told_as_that_of_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the clock of progress of the next one stops until it has caught up, and the worker seems to hang."""
    uplink = Deaf()
    worker = WorkerProcess("w", uplink)

    def work(system: object, request: RolloutRequest, progress: Callable[[int], None]) -> bytes:
        progress(900 if request.test == 0 else 1)
        if request.test == 0:
            worker.receive(an_assign(1))
            seen = len(uplink.states)
            while len(uplink.states) < seen + 3:
                time.sleep(0.005)
        return b"done"

    monkeypatch.setattr(module, "run_on", work)
    worker.receive(an_assign(0))
    served(worker, uplink, 2)
    told = {state.progress for state in uplink.states if state.rollout == "maximum.1.true.0"}
    assert told
    assert max(told) <= 1


def test_a_worker_that_lacks_a_module_of_the_system_is_at_fault_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    uplink = Deaf()
    worker = WorkerProcess("w", uplink)
    monkeypatch.setattr(module, "run_on", failing(raising(ImportError("libsimulator.so: no such file"))))
    worker.receive(an_assign(0))
    served(worker, uplink, 1)
    assert [header.kind for header in uplink.results] == ["infrastructure"]


def test_an_assignment_is_taken_once_and_never_an_older_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    uplink, ran = Deaf(), []
    worker = WorkerProcess("w", uplink)

    def work(system: object, request: RolloutRequest, progress: Callable[[int], None]) -> bytes:
        ran.append(request.test)
        if len(ran) == 1:
            worker.receive(an_assign(0, 2))
            worker.receive(an_assign(0, 1))
            worker.receive(an_assign(1))
        return b"done"

    monkeypatch.setattr(module, "run_on", work)
    worker.receive(an_assign(0, 2))
    served(worker, uplink, 2)
    assert [(header.rollout, header.attempt) for header in uplink.results] == [
        ("maximum.0.true.0", 2),
        ("maximum.1.true.0", 1),
    ]


@pytest.mark.parametrize("how", ["raises", "ends early", "obeys"])
def test_what_follows_a_cancel_is_no_failure_of_the_system(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """A system may catch `Cancelled`, raise its own error, or return what it has: the cancel is not its fault."""
    uplink = Deaf()
    worker = WorkerProcess("w", uplink)

    def work(system: object, request: RolloutRequest, progress: Callable[[int], None]) -> bytes:
        if request.test == 0:
            worker.receive(Cancel(rollout=request.rollout, attempt=1))
            worker.receive(an_assign(1))
            try:
                progress(1)
            except Cancelled as cancelled:
                if how == "raises":
                    raise RuntimeError("the step failed") from cancelled
                if how == "obeys":
                    raise
        return b"done"

    monkeypatch.setattr(module, "run_on", work)
    worker.receive(an_assign(0))
    served(worker, uplink, 1)
    assert [header.rollout for header in uplink.results] == ["maximum.1.true.0"]


def test_a_failure_before_its_cancel_is_one_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    uplink = Deaf()
    worker = WorkerProcess("w", uplink)

    def work(system: object, request: RolloutRequest, progress: Callable[[int], None]) -> bytes:
        worker.receive(Cancel(rollout=request.rollout, attempt=1))
        raise RuntimeError("the step failed")

    monkeypatch.setattr(module, "run_on", work)
    worker.receive(an_assign(0))
    served(worker, uplink, 1)
    (header,) = uplink.results
    assert header.kind == "system"
    assert says(header.error, "^RuntimeError: step test_service.py")


def test_the_end_is_reported_to_workers_that_came_since_the_last_turn_too(tmp_path: Path) -> None:
    begin(tmp_path / "run", SMALL)
    with closing(Journal.open(tmp_path / "run")) as journal, Network() as network:
        port, sent = InMemoryTransport(network), list[tuple[str, Request]]()
        server = Service(Ledger(tmp_path / "run", journal), journal, port, None, [], resumed=False)
        for message in appeared("early"):
            server._take(message)
        for message in (*appeared("late"), *appeared("late"), *appeared("early")):
            server.inbox.put(message)
        port.send = lambda worker, message: sent.append((worker, message))  # type: ignore[method-assign]
        server.report_end()
        assert sent == [("early", RunFinished()), ("late", RunFinished())]


def appeared(worker: str) -> tuple[Token, Heartbeat]:
    state = worker_state(worker, load_system("test-function").spec)
    return Token(0.0, worker, alive=True), Heartbeat(0.0, worker, state)

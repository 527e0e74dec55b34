"""A campaign with second opinions and workers that lie: what is recorded, reviewed and certified."""

import hashlib
import json
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.seeds import is_chosen
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.assumptions.opinions import MOST_NAMED
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import PerfboundError, Stopped
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.link.messages import ResultHeader
from perfbound.schemas.result.facts import Header
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from perfbound.workers.systems import load_system
from perfbound.workers.transport import Receiver
from tests.campaigns import UNCHECKED
from tests.facts import says
from tests.fakes.altering import AlteringUplink
from tests.fakes.inmemory import InMemoryUplink, Log, Network, Wrap, begin, campaign, hurry, run_of, serve, working
from tests.patience import patience

PRESET = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"


def a_config(**changes: Any) -> CampaignConfig:
    base = {"resolution": 11, "max_tests": 12, "replicates": 3, **UNCHECKED}
    return parse_campaign(PRESET.read_bytes(), "test", **{**base, **changes})


def honest(uplink: InMemoryUplink) -> InMemoryUplink:
    return uplink


class Liar(AlteringUplink):
    """The uplink of a worker that sends plausible results that are false."""

    def __init__(self, inner: InMemoryUplink, alter: Callable[[bytes], bytes]) -> None:
        super().__init__(inner)
        self._alter = alter

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Lie, in the same way each time."""
        altered = self._alter(payload)
        super().deliver(header.model_copy(update={"sha256": hashlib.sha256(altered).hexdigest()}), altered)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything as it is, in a tenth of the time, but nobody is lost on a slow machine: that leaves others alone."""
    hurry(monkeypatch, tick=0.02)
    monkeypatch.setattr(service, "Limits", partial(Limits, resend_after=0.15, others_within=0.5))


class Heard(AlteringUplink):
    """The uplink of an honest worker; its event is set with its first result."""

    def __init__(self, inner: InMemoryUplink, event: threading.Event) -> None:
        super().__init__(inner)
        self._event = event

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Pass on."""
        super().deliver(header, payload)
        self._event.set()


class LateLiar(Liar):
    """A liar whose first result waits for those of the others: alone, it would agree with itself."""

    def __init__(
        self, inner: InMemoryUplink, alter: Callable[[bytes], bytes], others: Sequence[threading.Event]
    ) -> None:
        super().__init__(inner, alter)
        self._others = others

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Lie, once all others have sent a result."""
        late = patience()
        while not (all(each.is_set() for each in self._others) or late()):
            time.sleep(0.01)
        super().deliver(header, payload)


def lie(payload: bytes) -> bytes:
    """Return a plausible file with another value."""
    file = read_mcap(payload)
    samples = file.trajectory.samples + np.array([0.0, 0.001])
    record = {name: text for name, text in file.metadata.items() if name != "columns"}
    units = dict.fromkeys(file.trajectory.columns, "1")
    return encode(Trajectory(file.trajectory.columns, samples), request=file.request, metadata=record, units=units)


def faults(directory: Path) -> list[str]:
    """Return the checks of `verify` that fail."""
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks.found
    return [f"{name}: {each.detail}" for name, each in found.items() if each.status == "failed"]


def opinions(directory: Path, kind: str) -> list[tuple[str, str]]:
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute("SELECT rollout, worker FROM opinions WHERE kind = ?", [kind]).fetchall()


def honesty(certificate: str) -> dict[str, Any]:
    (found,) = (each for each in json.loads(certificate)["predicate"]["assumptions"] if each["id"] == "workers_honest")
    return dict(found)


@pytest.mark.rest
def test_the_choice_follows_from_the_seed_and_has_the_share() -> None:
    spec = load_system("test-function").spec
    header = Header.new(a_config(second_opinion=0.05), spec, {})
    rollouts = [RolloutId("maximum", test, "true", 0) for test in range(4000)]
    chosen = [each for each in rollouts if is_chosen(header, each)]
    assert 140 < len(chosen) < 260
    other = Header.new(a_config(second_opinion=0.05, seed=2), spec, {})
    assert chosen != [each for each in rollouts if is_chosen(other, each)]
    assert not any(is_chosen(Header.new(a_config(), spec, {}), each) for each in rollouts)
    assert all(is_chosen(Header.new(a_config(second_opinion=1.0), spec, {}), each) for each in rollouts)


@pytest.mark.rest
def test_the_key_changes_neither_seeds_nor_numbers_and_the_number_of_workers_nothing(tmp_path: Path) -> None:
    config = a_config(second_opinion=0.3)
    assert config.digest == a_config().digest
    one, three = (campaign(tmp_path / str(count), config, workers=count) for count in (1, 3))
    assert one == three
    plain = json.loads(campaign(tmp_path / "plain", a_config()))["predicate"]
    assert {**json.loads(one)["predicate"], "assumptions": 0} == {**plain, "assumptions": 0}
    found = honesty(one)
    compared = found["values"]["compared"]
    assert found["status"] == "not refuted"
    assert 5 < compared == found["values"]["agreed"] < 20
    assert says(found["detail"], "30 % seed twice")
    assert found["values"]["percent"] == pytest.approx(100 * (1 - 0.05 ** (1 / compared)), abs=0.11)
    assert faults(tmp_path / "3") == []


@pytest.mark.rest
@pytest.mark.integration
def test_of_a_worker_that_lies_from_its_first_result_nothing_is_recorded(tmp_path: Path) -> None:
    config, log, directory = a_config(second_opinion=1.0), Log(), tmp_path / "run"
    begin(directory, config)
    events = [threading.Event() for _ in range(2)]
    liar: Wrap = lambda uplink: LateLiar(uplink, lie, events)  # noqa: E731
    others: list[Wrap] = [partial(Heard, event=each) for each in events]
    later = Log()
    with Network() as network, working(network, run_of(directory), [liar, *others]):
        with pytest.raises(Stopped):
            serve(directory, network, log, stop=lambda _: opinions(directory, "outvoted") != [])
        with closing(sqlite3.connect(directory / DATABASE)) as connection:
            (before,) = connection.execute("SELECT max(rowid) FROM attempts").fetchone()
        found = serve(directory, network, later, resumed=True)
    assert found == campaign(tmp_path / "calm", config, workers=2)
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        query = "SELECT count(*) FROM attempts WHERE rowid > ? AND worker LIKE 'worker-0-%'"
        assert connection.execute(query, [before]).fetchone() == (0,), "set aside through the resume"
    (again,) = [line for line in later.lines if line.startswith("outvoted in an earlier session")]
    assert says(again, "worker restarted")
    (line,) = [line for line in log.lines if "set aside for good" in line]
    assert line.startswith("worker worker-0-")
    assert {worker for _, worker in opinions(directory, "outvoted")} == {line.split()[1]}
    assert opinions(directory, "reviewed") == []


@pytest.mark.rest
def test_of_a_worker_that_is_alone_the_certificate_says_what_its_agreement_does_not_show(tmp_path: Path) -> None:
    config, directory = a_config(second_opinion=1.0), tmp_path / "run"
    begin(directory, config)
    liar: Wrap = lambda uplink: Liar(uplink, lie)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [liar]):
        found = honesty(serve(directory, network, Log()))
    assert found["values"]["compared"] == found["values"]["agreed"] == 36
    assert says(found["detail"], "no two results two workers alone")


@pytest.mark.rest
def test_what_a_worker_recorded_before_it_was_outvoted_is_simulated_again(tmp_path: Path) -> None:
    config, directory = a_config(second_opinion=0.3), tmp_path / "run"
    begin(directory, config)
    # Alone, the liar agrees with itself.
    liar: Wrap = lambda uplink: Liar(uplink, lie)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [liar]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 12)
    with closing(sqlite3.connect(directory / DATABASE)) as connection, connection:
        rows = connection.execute("SELECT rollout, worker FROM outcomes WHERE outcome = 'recorded'").fetchall()
        # Of another worker, which was killed before the third attempt at a rollout.
        for kind, worker in (("outvoted", rows[0][1]), ("compared", "killed")):
            values = (kind, rows[0][0], 1, worker, "0" * 64, 0.0)
            connection.execute(
                "INSERT INTO opinions (kind, rollout, attempt, worker, sha256, at) VALUES (?,?,?,?,?,?)", values
            )
    log = Log()
    with Network() as network, working(network, run_of(directory), [honest, honest]):
        found = serve(directory, network, log, resumed=True)
    suspects = {rollout for rollout, _ in rows}
    assert suspects & {rollout for rollout, _ in opinions(directory, "compared")}, "some agree with themselves alone"
    assert any(says(each, f"{len(suspects)} rollouts outvoted again") for each in log.lines)
    assert {rollout for rollout, _ in opinions(directory, "reviewed")} == set(read.contradicted(directory)) == suspects
    told = honesty(found)
    assert told["status"] == "refuted"
    assert says(told["detail"], f"{len(suspects)} rollouts recorded another trajectory")
    assert all(rollout in told["detail"] for rollout in suspects)
    assert faults(directory) == []


@pytest.mark.rest
def test_a_review_that_is_interrupted_goes_on_and_verifies_without_the_opinions(tmp_path: Path) -> None:
    config, directory = a_config(second_opinion=0.3), tmp_path / "run"
    begin(directory, config)
    liar: Wrap = lambda uplink: Liar(uplink, lie)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [liar]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 24)
    false = recorded(directory)
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        ((name,),) = connection.execute("SELECT DISTINCT worker FROM outcomes").fetchall()
    insert(directory, ("outvoted", next(iter(false)), 1, name, "0" * 64))
    with Network() as network, working(network, run_of(directory), [honest]):
        with pytest.raises(Stopped):
            serve(directory, network, Log(), stop=lambda _: len(opinions(directory, "reviewed")) >= 3, resumed=True)
        assert not (directory / files.CERTIFICATE).exists()
        found = serve(directory, network, Log(), resumed=True)
    assert set(read.contradicted(directory)) == set(false)
    assert len(opinions(directory, "reviewed")) == len(false) > MOST_NAMED
    assert honesty(found)["values"]["count"] == len(false)
    assert faults(directory) == []
    with closing(sqlite3.connect(directory / DATABASE)) as connection, connection:
        connection.execute("DROP TRIGGER opinions_no_delete")
        connection.execute("DELETE FROM opinions")
    assert faults(directory) == [], "a certificate is believed that admits more than the database shows"


def recorded(directory: Path) -> dict[str, str]:
    """Return the digest of each recorded rollout."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        rows = connection.execute("SELECT problem, test, variant, replicate, sha256 FROM rollouts").fetchall()
    return {".".join(map(str, row[:4])): row[4] for row in rows}


def false_rollouts(directory: Path, calm: Path) -> set[str]:
    """Return the recorded rollouts that honest workers do not send."""
    right = recorded(calm)
    return {rollout for rollout, sha256 in recorded(directory).items() if right.get(rollout, sha256) != sha256}


@pytest.mark.rest
@pytest.mark.integration
def test_after_a_vote_without_majority_no_resume_lets_the_liar_agree_with_itself(tmp_path: Path) -> None:
    config, directory, heard = a_config(second_opinion=1.0), tmp_path / "run", threading.Event()
    calm = campaign(tmp_path / "calm", config)
    begin(directory, config)
    liar: Wrap = lambda uplink: LateLiar(uplink, lie, [heard])  # noqa: E731
    with Network() as network:
        with working(network, run_of(directory), [liar]):
            two = working(network, run_of(directory), [partial(Heard, event=heard)])
            with two, pytest.raises(PerfboundError, match=r"a trajectory like no other one"):
                serve(directory, network, Log())
            compared = set(opinions(directory, "compared"))
            # Of others the liar may have sent a result, and nobody else: there it agrees with itself.
            disputed = {one for one, worker in compared if any(one == two and worker != each for two, each in compared)}
            assert disputed
            with pytest.raises(PerfboundError, match=r"a trajectory like no other one"):
                serve(directory, network, Log(), resumed=True)
            assert not disputed & set(recorded(directory)), "alone, the liar has no majority"
        # Without the liar: where it reports first and these do not for a while, the run would end as the one before.
        with working(network, run_of(directory), [honest, honest]):
            found = serve(directory, network, Log(), resumed=True)
    false = false_rollouts(directory, tmp_path / "calm")
    assert len({worker for _, worker in opinions(directory, "outvoted")}) == 1
    assert set(read.contradicted(directory)) == false
    assert honesty(found)["status"] == ("refuted" if false else "not refuted")
    assert false or found == calm
    assert faults(directory) == []


def insert(directory: Path, *rows: tuple[str, str, int, str, str]) -> None:
    """Add opinions: kind, rollout, attempt, worker, sha256."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection, connection:
        query = "INSERT INTO opinions (kind, rollout, attempt, worker, sha256, at) VALUES (?,?,?,?,?,0)"
        connection.executemany(query, rows)


@pytest.mark.rest
def test_two_that_differed_before_a_restart_are_decided_on_after_it(tmp_path: Path) -> None:
    config, directory = a_config(second_opinion=0.3), tmp_path / "run"
    campaign(tmp_path / "calm", config)
    begin(directory, config)
    liar: Wrap = lambda uplink: Liar(uplink, lie)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [liar]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 12)
    false = recorded(directory)
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        ((name,),) = connection.execute("SELECT DISTINCT worker FROM outcomes").fetchall()
    # As if another one had joined for a moment, and the orchestrator been killed before a third was asked.
    right = recorded(tmp_path / "calm")
    rollout = next(each for each in right if each not in false)
    insert(directory, ("compared", rollout, 1, name, "0" * 64), ("compared", rollout, 2, "other", right[rollout]))
    with Network() as network, working(network, run_of(directory), [honest, honest]):
        found = serve(directory, network, Log(), resumed=True)
    assert {worker for _, worker in opinions(directory, "outvoted")} == {name}
    assert set(read.contradicted(directory)) == set(false) == false_rollouts(directory, tmp_path / "calm")
    assert honesty(found)["status"] == "refuted"


class Later(AlteringUplink):
    """The uplink of an honest worker that joins with an event."""

    def __init__(self, inner: InMemoryUplink, event: threading.Event) -> None:
        super().__init__(inner)
        self._event = event

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Pass on, late."""
        late = patience()
        while not (self._event.is_set() or late()):
            time.sleep(0.01)
        super().join(run, worker, receive)


class Awaiting(Log):
    """A listener that sets an event when a rollout waits for another worker."""

    def __init__(self, event: threading.Event) -> None:
        super().__init__()
        self._event = event

    def print_line(self, line: str) -> None:
        """Keep a line."""
        super().print_line(line)
        if "waits at most 30 s for another worker" in line:
            self._event.set()


@pytest.mark.rest
@pytest.mark.integration
def test_after_a_resume_the_worker_that_reports_first_does_not_end_the_vote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "Limits", partial(Limits, resend_after=0.15, others_within=30.0))
    config, directory, awaited = a_config(second_opinion=0.3), tmp_path / "run", threading.Event()
    campaign(tmp_path / "calm", config)
    begin(directory, config)
    liar: Wrap = lambda uplink: Liar(uplink, lie)  # noqa: E731
    log = Awaiting(awaited)
    with Network() as network, working(network, run_of(directory), [liar, partial(Later, event=awaited)]):
        with pytest.raises(Stopped):
            serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 12)
        false, right = recorded(directory), recorded(tmp_path / "calm")
        with closing(sqlite3.connect(directory / DATABASE)) as connection:
            ((name,),) = connection.execute("SELECT DISTINCT worker FROM outcomes").fetchall()
        rollout = next(each for each in right if each not in false)
        insert(directory, ("compared", rollout, 1, name, "0" * 64), ("compared", rollout, 2, "other", right[rollout]))
        serve(directory, network, log, resumed=True)
    (line,) = [each for each in log.lines if "waits at most" in each]
    assert says(line, "all other rollouts continue")
    assert {worker for _, worker in opinions(directory, "outvoted")} == {name}
    # It may record one more before it is outvoted.
    assert set(false) <= set(read.contradicted(directory)) == false_rollouts(directory, tmp_path / "calm")


@pytest.mark.rest
def test_two_that_differ_on_a_rollout_that_is_no_longer_needed_are_decided_on_before_the_certificate(
    tmp_path: Path,
) -> None:
    config, directory = a_config(second_opinion=0.3), tmp_path / "run"
    begin(directory, config)
    with Network() as network, working(network, run_of(directory), [honest]):
        with pytest.raises(Stopped):
            serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 12)
        compared = {name for name, _ in opinions(directory, "compared")}
        rollout = [each for each in recorded(directory) if each not in compared][-1]
        # Recorded already: nothing but the review asks for it again.
        insert(directory, ("compared", rollout, 8, "a", "0" * 64), ("compared", rollout, 9, "b", "1" * 64))
        log = Log()
        with pytest.raises(PerfboundError, match=f"rollout {rollout} failed 3 times"):
            serve(directory, network, log, resumed=True)
    assert any(says(each, "1 rollouts two workers again") for each in log.lines)
    with Network() as network, working(network, run_of(directory), [honest]):
        found = serve(directory, network, Log(), resumed=True)
    assert {worker for _, worker in opinions(directory, "outvoted")} == {"a", "b"}
    assert found == campaign(tmp_path / "calm", config)


@pytest.mark.rest
def test_what_was_open_is_numbered_on_also_where_damaged_files_come_first(tmp_path: Path) -> None:
    config, directory = a_config(), tmp_path / "run"
    begin(directory, config)
    with Network() as network, working(network, run_of(directory), [honest, honest]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 6)
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        query = "SELECT DISTINCT rollout FROM attempts EXCEPT SELECT rollout FROM outcomes WHERE outcome = 'recorded'"
        opened = {row[0] for row in connection.execute(query)}
        (before,) = connection.execute("SELECT max(session) FROM attempts").fetchone()
        path = connection.execute("SELECT path FROM rollouts ORDER BY seq DESC LIMIT 1").fetchone()[0]
    assert opened
    (directory / path).unlink()
    with Network() as network, working(network, run_of(directory), [honest, honest]):
        found = serve(directory, network, Log(), resumed=True)
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        # One with the number of an earlier attempt has no row of its own.
        query = "SELECT rollout FROM attempts WHERE session > ?"
        later = {row[0] for row in connection.execute(query, [before])}
    assert opened <= later
    assert found == campaign(tmp_path / "calm", config)

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

from perfbound.orchestrator.campaign.second_opinion import is_chosen
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.fleet.limits import Limits
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.campaign import CampaignConfig
from perfbound.schemas.campaign_file import parse_campaign
from perfbound.schemas.errors import Stopped
from perfbound.schemas.facts import Header
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.messages import ResultHeader
from perfbound.schemas.trajectory import Trajectory, encode, read_mcap
from perfbound.workers.systems import load_system
from tests.campaigns import UNCHECKED
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
    monkeypatch.setattr(service, "Limits", partial(Limits, resend_after=0.15))


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
    assert "30 % of the rollouts, drawn from the seed, were simulated twice" in found["detail"]
    assert found["values"]["percent"] == pytest.approx(100 * (1 - 0.05 ** (1 / compared)), abs=0.11)
    assert faults(tmp_path / "3") == []


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
    assert again.endswith("; a worker that is restarted is compared anew")
    (line,) = [line for line in log.lines if "set aside for good" in line]
    assert line.startswith("worker worker-0-")
    assert {worker for _, worker in opinions(directory, "outvoted")} == {line.split()[1]}
    assert opinions(directory, "reviewed") == []


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
    assert f"{len(suspects)} rollouts of outvoted workers are simulated again" in log.lines
    assert {rollout for rollout, _ in opinions(directory, "reviewed")} == set(read.contradicted(directory)) == suspects
    told = honesty(found)
    assert told["status"] == "refuted"
    assert f"{len(suspects)} of the rollouts that it had recorded had another trajectory" in told["detail"]
    assert all(rollout in told["detail"] for rollout in suspects)
    assert faults(directory) == []

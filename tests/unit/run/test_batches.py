"""Campaigns in batches with real workers in one process: what fails in a batch, is repeated, compared or forged."""

import hashlib
import json
import lzma
import sqlite3
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.opinions import PARTLY
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.collision import PoisonedError
from perfbound.orchestrator.run.service import RunStatus
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.export import table_rows
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.rows import DATABASE, work_name
from perfbound.schemas.errors import PerfboundError, Stopped
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.link.messages import ResultHeader
from perfbound.schemas.trajectory.batch import Batch, encode_batch, read_batch, with_failures
from tests.facts import says
from tests.fakes.altering import AlteringUplink
from tests.fakes.inmemory import InMemoryUplink, Log, Network, Wrap, begin, campaign, hurry, run_of, serve, working
from tests.faults.verdict import REPRODUCIBLE, without
from tests.unit.campaign.batches.test_batched_campaign import sampled
from tests.unit.run.test_second_opinion import insert

WHOLE, ROLLOUTS = 3, 50
"""Batches with 16 rollouts, and rollouts of all."""
Alter = Callable[[bytes], bytes]


def a_config(**changes: Any) -> CampaignConfig:
    return sampled(16, ROLLOUTS, max_attempts=50, **changes)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch, tick=0.02)
    monkeypatch.setattr(service, "Limits", partial(Limits, resend_after=0.15, others_within=0.5))


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> str:
    return campaign(tmp_path_factory.mktemp("calm") / "run", a_config())


class Altering(AlteringUplink):
    """The uplink of a worker whose files are altered: those of its first whole batches."""

    def __init__(self, inner: InMemoryUplink, alter: Alter, batches: int = 1000) -> None:
        super().__init__(inner)
        self._alter, self._left = alter, batches
        self._altered: dict[tuple[str, int], bytes] = {}

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Alter the file, and its digest; a result that is delivered again is the same."""
        key = header.rollout, header.attempt
        if header.outcome == "done" and header.rollout.endswith(".16") and len(self._altered) < self._left:
            self._altered.setdefault(key, self._alter(payload))
        payload = self._altered.get(key, payload)
        super().deliver(header.model_copy(update={"sha256": header.sha256 and sha256(payload)}), payload)


class Once(Altering):
    """The same, and nothing comes after the first of them."""

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Send it, also again."""
        if not self._altered or (header.rollout, header.attempt) in self._altered:
            super().deliver(header, payload)


def sha256(payload: bytes) -> str:
    return hashlib.sha256(payload).hexdigest()


def losing(*places: int) -> Alter:
    return lambda payload: with_failures(payload, dict.fromkeys(places, "it diverged"))


def query(directory: Path, text: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute(text).fetchall()


def assumption(certificate: str, name: str) -> dict[str, Any]:
    (found,) = (each for each in json.loads(certificate)["predicate"]["assumptions"] if each["id"] == name)
    return dict(found)


def check(directory: Path) -> None:
    """Check that each file has one recorded attempt of its name, and that the run verifies."""
    names = Counter(work_name(path) for (path,) in query(directory, "SELECT path FROM rollouts"))
    assert set(names.values()) == {1}
    outcomes = query(directory, "SELECT rollout FROM outcomes WHERE outcome = 'recorded'")
    assert Counter(name for (name,) in outcomes) == names
    attempts = query(directory, "SELECT rollout, count(*), max(attempt) FROM attempts GROUP BY rollout")
    assert all(count == highest for _, count, highest in attempts)
    assert {name for name, *_ in attempts} == set(names)
    columns, rows = table_rows(directory, "rollouts")
    assert len(rows) == ROLLOUTS
    worker = [each.name for each in columns].index("worker")
    assert all(row[worker] for row in rows)
    assert faults(directory) == []


def faults(directory: Path) -> list[str]:
    """Return the checks of `verify` that fail."""
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks.lines()
    return [f"{each.name}: {each.detail}" for each in found if each.status == "failed"]


def equal_but_for_the_seeds(one: str, other: str) -> bool:
    """Whether two certificates differ at most in whether rollouts follow from their seeds, and in the files."""
    found = [without(each.encode(), REPRODUCIBLE) for each in (one, other)]
    for each in found:
        del each["subject"], each["predicate"]["evidence"]["manifest_sha256"]
    return found[0] == found[1]


def test_a_rollout_that_fails_in_its_batch_alone_does_not_follow_from_its_seed(tmp_path: Path, calm: str) -> None:
    directory, config = tmp_path / "run", a_config()
    begin(directory, config)
    # The first one is simulated twice, since its times are not known yet.
    flaky: Wrap = lambda uplink: Altering(uplink, losing(0, 1), batches=3)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [flaky]):
        found = serve(directory, network, Log())
    check(directory)
    assert equal_but_for_the_seeds(found, calm)
    told = assumption(found, REPRODUCIBLE)
    assert (told["status"], told["values"]["failed"]) == ("refuted", 4)
    assert assumption(calm, REPRODUCIBLE)["status"] != "refuted"
    assert read.irreproducible(directory) == 0, "no attempt has failed as a whole"


def test_without_the_database_the_files_show_that_rollouts_failed_in_their_batches(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    begin(directory, a_config())
    flaky: Wrap = lambda uplink: Altering(uplink, losing(3))  # noqa: E731
    with Network() as network, working(network, run_of(directory), [flaky]):
        text = serve(directory, network, Log())
    told = assumption(text, REPRODUCIBLE)
    assert told["values"]["failed"] == WHOLE
    with closing(sqlite3.connect(directory / DATABASE)) as connection, connection:
        for table in ("outcomes", "attempts"):
            connection.execute(f"DROP TRIGGER {table}_no_delete")
            connection.execute(f"DELETE FROM {table}")
    assert faults(directory) == []
    hidden = text.replace(f'"failed": {WHOLE}', f'"failed": {WHOLE - 1}')
    assert hidden != text
    (directory / "certificate.json").write_text(hidden)
    assert [each.partition(":")[0] for each in faults(directory)] == ["audit"]


def has_files(directory: Path, count: int, _: object) -> bool:
    return bool(query(directory, "SELECT count(*) FROM rollouts")[0][0] >= count)


def test_after_a_restart_the_retries_of_a_batch_go_on(tmp_path: Path, calm: str) -> None:
    directory, config = tmp_path / "run", a_config()
    begin(directory, config)
    flaky: Wrap = lambda uplink: Altering(uplink, losing(0))  # noqa: E731
    for count in (1, 2, 3):
        stop = partial(has_files, directory, count)
        with Network() as network, working(network, run_of(directory), [flaky]), pytest.raises(Stopped):
            serve(directory, network, Log(), stop=stop, resumed=count > 1)
    with Network() as network, working(network, run_of(directory), [flaky]):
        found = serve(directory, network, Log(), resumed=True)
    assert equal_but_for_the_seeds(found, calm)
    assert assumption(found, REPRODUCIBLE)["values"]["failed"] == WHOLE
    names = query(directory, "SELECT DISTINCT rollout FROM attempts WHERE rollout LIKE 'robustness.0.true.0.%'")
    assert set(names) == {("robustness.0.true.0.16",), ("robustness.0.true.0.1",)}


def test_a_rollout_that_fails_alone_as_in_its_batch_ends_the_campaign(tmp_path: Path) -> None:
    class Failing(AlteringUplink):
        def deliver(self, header: ResultHeader, payload: bytes) -> None:
            if header.rollout == "robustness.0.true.0.1":
                header = header.model_copy(
                    update={"outcome": "failed", "sha256": "", "error": "it diverged", "kind": "system"}
                )
                payload = b""
            elif header.rollout == "robustness.0.true.0.16":
                payload = losing(0)(payload)
                header = header.model_copy(update={"sha256": hashlib.sha256(payload).hexdigest()})
            super().deliver(header, payload)

    directory = tmp_path / "run"
    begin(directory, a_config())
    with Network() as network, working(network, run_of(directory), [Failing, Failing]):
        with pytest.raises(PerfboundError, match=r"robustness\.0\.true\.0\.1 failed 2 times.*it diverged"):
            serve(directory, network, Log())
        with pytest.raises(PerfboundError, match=r"failed [23] times"):
            serve(directory, network, Log(), resumed=True)


def test_a_first_batch_that_fails_in_part_and_not_in_its_repetition_is_a_failure_of_the_system(
    tmp_path: Path, calm: str
) -> None:
    directory = tmp_path / "run"
    begin(directory, a_config())
    flaky: Wrap = lambda uplink: Altering(uplink, losing(0, 1), batches=1)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [flaky]):
        found = serve(directory, network, Log())
    check(directory)
    assert query(directory, "SELECT rollout, attempt, outcome FROM outcomes WHERE kind = 'system'") == [
        ("robustness.0.true.0.16", 1, PARTLY.reason)
    ]
    assert assumption(found, REPRODUCIBLE)["values"]["failed"] == 1
    assert equal_but_for_the_seeds(found, calm)


def test_a_batch_that_fails_as_a_whole_ends_the_campaign_and_no_rollout_is_blamed(tmp_path: Path) -> None:
    class Failing(AlteringUplink):
        def deliver(self, header: ResultHeader, payload: bytes) -> None:
            failed = {"outcome": "failed", "sha256": "", "error": "no licence", "kind": "system"}
            super().deliver(header.model_copy(update=failed), b"")

    directory = tmp_path / "run"
    begin(directory, a_config())
    # A failure that sets its worker aside does not count.
    refused = pytest.raises(PoisonedError, match=r"^batch robustness\.\d+\.true\.0\.\d+ failed [23] times")
    with Network() as network, working(network, run_of(directory), [Failing, Failing]), refused as error:
        serve(directory, network, Log())
    assert error.value.request is None


def test_what_is_under_way_or_waits_is_counted_in_rollouts(tmp_path: Path) -> None:
    begin(directory := tmp_path / "run", a_config())
    counts = list[int]()

    def seen(status: RunStatus) -> bool:
        counts.append(status.recorded + status.under_way + status.waiting)
        return False

    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink]):
        serve(directory, network, Log(), stop=seen)
    assert set(counts) == {ROLLOUTS}


# Second opinions


def test_each_rollout_that_fails_in_its_batch_is_said_and_listed(tmp_path: Path) -> None:
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    flaky: Wrap = lambda uplink: Altering(uplink, losing(2, 5), batches=2)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [flaky]):
        serve(directory, network, log)
    lines = [line for line in log.lines if "system failure: it diverged" in line]
    names = [line.split(",")[0] for line in lines]
    assert len(names) == 2
    columns, rows = table_rows(directory, "failures")
    listed = [dict(zip((each.name for each in columns), row, strict=True)) for row in rows]
    assert [(each["rollout"], each["kind"], each["reason"]) for each in listed if each["reason"] == "it diverged"] == [
        (name, "system", "it diverged") for name in names
    ]
    progress = read_progress(directory)
    assert (progress.failures, progress.system_failures) == (len(listed), len(listed))
    report = Collector(directory).refresh()
    assert (report.throughput.failures, report.throughput.system_failures) == (len(listed), len(listed))
    assert sum(each.failures for each in report.workers) == len(listed)
    assert {each.rollout for each in report.failed_attempts} == {each["rollout"] for each in listed}


@pytest.mark.rest
def test_failures_in_the_batches_of_one_worker_outvote_nobody(tmp_path: Path, calm: str) -> None:
    directory, config = tmp_path / "run", a_config(second_opinion=1.0)
    begin(directory, config)
    flaky: Wrap = lambda uplink: Altering(uplink, losing(0, 1))  # noqa: E731
    log = Log()
    with Network() as network, working(network, run_of(directory), [flaky, *[lambda uplink: uplink] * 2]):
        found = serve(directory, network, log)
    check(directory)
    assert query(directory, "SELECT * FROM opinions WHERE kind = 'outvoted'") == []
    honest = assumption(found, "workers_honest")
    files = query(directory, "SELECT * FROM rollouts")
    assert (honest["status"], honest["values"]["compared"]) == ("not refuted", len(files))
    # One batch in four has a third of the rollouts.
    assert honest["values"]["percent"] > 100 * (1 - 0.05 ** (1 / len(files)))
    assert assumption(found, REPRODUCIBLE)["status"] == "refuted"
    assert not [line for line in log.lines if "for good" in line]
    assert calm
    assert {reason for (reason,) in query(directory, "SELECT outcome FROM outcomes WHERE kind = 'system'")} <= {
        PARTLY.reason
    }


@pytest.mark.rest
def test_failures_in_a_batch_of_before_a_restart_outvote_nobody(tmp_path: Path) -> None:
    """The first opinion lacks a rollout that both later ones have."""
    directory, config = tmp_path / "run", a_config(second_opinion=1.0)
    begin(directory, config)

    def compared(_: RunStatus) -> bool:
        return bool(query(directory, "SELECT * FROM opinions WHERE length(digests) = 512"))

    # Two more results of the only worker, which do not agree with its first one, could end the campaign first.
    with (
        Network() as network,
        working(network, run_of(directory), [lambda uplink: Once(uplink, losing(1))]),
        pytest.raises(Stopped),
    ):
        serve(directory, network, Log(), stop=compared)
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        found = serve(directory, network, Log(), resumed=True)
    assert query(directory, "SELECT worker FROM opinions WHERE kind = 'outvoted'") == []
    assert PARTLY.reason in {reason for (reason,) in query(directory, "SELECT outcome FROM outcomes")}
    assert assumption(found, "workers_honest")["status"] == "not refuted"


def shifted(payload: bytes) -> bytes:
    """Return a plausible file with another value in one rollout."""
    batch, request, metadata = read_batch(payload)
    values = batch.values.copy()
    values[:, 1] += 0.001
    rest = {name: text for name, text in metadata.items() if name != "columns"}
    return encode_batch(Batch(batch.columns, batch.time, values), request=json.loads(request), metadata=rest)


def outvote(directory: Path) -> list[tuple[Any, ...]]:
    """Let the only worker so far be outvoted; return what it has recorded."""
    rows = query(directory, "SELECT rollout, worker FROM outcomes WHERE outcome = 'recorded'")
    insert(directory, ("outvoted", rows[0][0], 1, rows[0][1], "0" * 64))
    return rows


@pytest.mark.rest
def test_what_an_outvoted_worker_recorded_in_batches_is_simulated_again(tmp_path: Path) -> None:
    directory, config = tmp_path / "run", a_config(second_opinion=0.3)
    begin(directory, config)
    # Alone, the liar agrees with itself; of one of its batches a rollout fails, and is made again alone.
    liar: Wrap = lambda uplink: Altering(uplink, lambda payload: losing(2)(shifted(payload)))  # noqa: E731
    with Network() as network, working(network, run_of(directory), [liar]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 20)
    rows = outvote(directory)
    log = Log()
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        found = serve(directory, network, log, resumed=True)
    reviewed = {name for (name,) in query(directory, "SELECT rollout FROM opinions WHERE kind = 'reviewed'")}
    assert reviewed == {name for name, _ in rows}
    false = {name for name in reviewed if name.endswith(".16")}
    assert set(read.contradicted(directory)) == false, "a rollout that was made again alone is no false one"
    honest = assumption(found, "workers_honest")
    assert (honest["values"]["count"], honest["form"]) == (len(false), "outvoted_in_batches")
    several = sum(int(name.split(".")[4]) for name in reviewed)
    assert any(says(line, f"{several} rollouts outvoted again") for line in log.lines)
    assert faults(directory) == []


@pytest.mark.rest
def test_a_batch_that_failed_in_part_is_the_same_in_its_review(tmp_path: Path) -> None:
    directory, config = tmp_path / "run", a_config(second_opinion=0.3)
    begin(directory, config)
    flaky: Wrap = lambda uplink: Altering(uplink, losing(2))  # noqa: E731
    with Network() as network, working(network, run_of(directory), [flaky]), pytest.raises(Stopped):
        serve(directory, network, Log(), stop=lambda seen: seen.recorded >= 20)
    outvote(directory)
    with Network() as network, working(network, run_of(directory), [lambda uplink: uplink] * 2):
        found = serve(directory, network, Log(), resumed=True)
    assert read.contradicted(directory) == []
    assert assumption(found, "workers_honest")["status"] == "not refuted"


# Hostile results, of a worker that proves them


def rewritten(change: Callable[[dict[str, Any]], None]) -> Alter:
    """Return how a file is written anew, with other parts."""

    def alter(payload: bytes) -> bytes:
        batch, request, metadata = read_batch(payload)
        parts: dict[str, Any] = {
            "columns": batch.columns,
            "time": batch.time.copy(),
            "values": batch.values.copy(),
            "failures": {},
        }
        parts["request"] = json.loads(request)
        change(parts)
        made = object.__new__(Batch)  # without the checks of an honest worker
        for name in ("columns", "time", "values", "failures"):
            object.__setattr__(made, name, parts[name])
        rest = {name: text for name, text in metadata.items() if name != "columns"}
        return encode_batch(made, request=parts["request"], metadata=rest)

    return alter


def of_parts(name: str, value: Callable[[Any], Any]) -> Alter:
    return rewritten(lambda parts: parts.update({name: value(parts[name])}))


def with_nan(values: Any) -> Any:
    values[0, 3, 1] = np.nan
    return values


def with_false_mask(payload: bytes) -> bytes:
    """Return a file that says that a rollout has failed, whose samples are there."""
    return rewritten(lambda parts: parts.update(failures={3: "it diverged"}))(payload)


FORGED: dict[str, tuple[Alter, str]] = {
    "a row less": (of_parts("values", lambda values: values[:, :-1].copy()), "15 rollouts, and 16 were requested"),
    "a rollout twice": (
        of_parts("values", lambda values: np.concatenate((values, values[:, :1]), axis=1)),
        "17 rollouts, and 16 were requested",
    ),
    "samples less": (rewritten(lambda parts: parts.update(time=parts["time"][:-1].copy())), "times have shape"),
    "a number that is none": (of_parts("values", with_nan), "nan"),
    "a column more": (of_parts("columns", lambda columns: (*columns, "more")), "for 3 columns"),
    "another grid": (of_parts("time", lambda time: time * 0.5), "the last row, 1, is at t = 0.15 s"),
    "a mask that lies": (with_false_mask, "samples of a failed rollout are zeros"),
    "a mask of another place": (rewritten(lambda parts: parts.update(failures={99: "it diverged"})), "places"),
    "a mask of all": (
        rewritten(lambda parts: parts.update(failures=dict.fromkeys(range(16), "x"), values=parts["values"] * 0.0)),
        "failures are those of some",
    ),
    "other seeds": (
        of_parts("request", lambda request: {**request, "seeds": request["seeds"][::-1]}),
        "for another request",
    ),
    "a start twice": (
        of_parts("request", lambda request: {**request, "x": [request["x"][0], *request["x"][:-1]]}),
        "for another request",
    ),
    "half of the file": (lambda payload: payload[: len(payload) // 2], "not a batch"),
    "zeros that were compressed": (lambda _: lzma.compress(bytes(2**26)), "not a batch"),
    "more behind its end": (lambda payload: payload + bytes(2**20), "not a batch"),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_batch_is_one_line_and_the_campaign_goes_on(name: str, tmp_path: Path, calm: str) -> None:
    alter, reason = FORGED[name]
    directory, log = tmp_path / "run", Log()
    begin(directory, a_config())
    forger: Wrap = lambda uplink: Altering(uplink, alter, batches=1)  # noqa: E731
    with Network() as network, working(network, run_of(directory), [forger]):
        found = serve(directory, network, log)
    (line,) = [each for each in log.lines if "failure: " in each]
    assert reason in line
    assert line.startswith("robustness.")
    assert equal_but_for_the_seeds(found, calm)
    check(directory)

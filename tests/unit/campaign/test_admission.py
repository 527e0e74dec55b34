"""What the objective needs of a rollout is checked before it is a fact; what is a fact already can be discarded."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.admission import check_whole
from perfbound.orchestrator.campaign.ledger import Ledger, observed_discards
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.run import discard as run_discard
from perfbound.orchestrator.run.certify import certify
from perfbound.orchestrator.run.discard import discard_rollout
from perfbound.orchestrator.run.service import Service
from perfbound.orchestrator.store import discard as store_discard
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import PerfboundError, UnusableTrajectoryError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.link.messages import Assign, Request
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from tests.campaigns import table
from tests.facts import facts
from tests.fakes.finished import KERNEL, a_pair
from tests.fakes.puppets import Puppets, Stage

ODD, PARTNER = RolloutId("sim_gap", 3, "true", 0), RolloutId("sim_gap", 3, "nominal", 0)
BEFORE = RolloutId("sim_gap", 2, "true", 0)


def unclipped(**changes: Any) -> CampaignConfig:
    """Return the maximum of a column, without a clip."""
    problem = {"method": "paper", "name": "maximum", "column": "value", "delta": 0.05, "alpha": 0.001, "rkhs_norm": 0.3}
    problem |= {"kernel": KERNEL, "noise_scale": 0.01, "c": 0.05, "replicates": 2}
    found = table(
        "test-function",
        horizon=0.3,
        specification="always (value >= 0.002)",
        problems=[problem],
        composition="single",
        resolution=7,
        max_tests=4,
        **changes,
    )
    return CampaignConfig.model_validate_json(json.dumps(found))


def changed(payload: bytes, value: float | None = None, *, shift: float = 0.0) -> bytes:
    """Return a file with another value in its second row, or another time of it."""
    file = read_mcap(payload)
    samples = np.array(file.trajectory.samples)
    samples[1, 0] += shift
    if value is not None:
        samples[1, 1] = value
    columns = file.trajectory.columns
    metadata = {key: text for key, text in file.metadata.items() if key != "columns"}
    units = dict.fromkeys(columns, "1") | {"t": "s"}
    return encode(Trajectory(columns, samples), request=file.request, metadata=metadata, units=units)


class Odd(Puppets):
    """Puppets that answer one rollout oddly, the first `times` times."""

    rollout, value, shift, times = str(ODD), None, 0.0, 1

    held = ""
    """The rollout that is not answered."""

    def send(self, worker: str, message: Request) -> None:
        if not isinstance(message, Assign) or message.request.rollout != self.held:
            super().send(worker, message)

    def file(self, request: RolloutRequest) -> bytes:
        found = super().file(request)
        if request.rollout != self.rollout or not self.times:
            return found
        self.times -= 1
        return changed(found, self.value, shift=self.shift)


def odd(directory: Path, config: CampaignConfig, workers: int = 3, **answers: Any) -> Stage:
    stage = Stage(directory, config, workers)
    stage.puppets = Odd(stage.journal.header.spec, workers)
    for name, each in answers.items():
        setattr(stage.puppets, name, each)
    return stage


def outcomes(directory: Path, rollout: RolloutId) -> list[tuple[str, str | None]]:
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        query = "SELECT outcome, kind FROM outcomes WHERE rollout = ? ORDER BY attempt"
        return connection.execute(query, (str(rollout),)).fetchall()


@pytest.mark.parametrize(
    ("config", "rollout", "answer", "reason"),
    [
        (a_pair("paper"), ODD, {"shift": 0.001}, "the time grids differ at sample 1"),
        (a_pair("paper"), ODD, {"value": -1.7e308}, "the gap is 1.7e+308, beyond 1e+100"),
        (
            a_pair("rigorous", spot_check=4),
            RolloutId("spot_check", 2, "true", 0),
            {"shift": 0.001},
            "the time grids differ",
        ),
        (a_pair("paper", recheck=2), RolloutId("recheck", 0, "true", 0), {}, "recorded"),
        (unclipped(), RolloutId("maximum", 1, "true", 1), {"value": 1.7e308}, "the maximum is 1.7e+308, beyond"),
    ],
    ids=["grid", "gap", "spot-check", "recheck", "maximum"],
)
def test_a_rollout_without_an_objective_is_a_failed_attempt(
    tmp_path: Path, config: CampaignConfig, rollout: RolloutId, answer: dict[str, Any], reason: str
) -> None:
    stage = odd(tmp_path / "run", config, rollout=str(rollout), **answer)
    stage.play()
    assert stage.ledger.done
    certify(tmp_path / "run", stage.ledger)
    stage.journal.close()
    found = outcomes(tmp_path / "run", rollout)
    if answer:
        assert found[0][1] == "system"
        assert reason in found[0][0]
        assert found[1:] == [("recorded", None)]
    assert verify(tmp_path / "run") == {}


@pytest.mark.parametrize(
    ("method", "workers", "test"), [("paper", 1, 0), ("paper", 2, 0), ("paper", 3, 3), ("rigorous", 3, 0)]
)
def test_the_first_rollout_of_a_pair_is_found_if_its_time_grid_is_another_one(
    tmp_path: Path, method: str, workers: int, test: int
) -> None:
    first = RolloutId("sim_gap", test, "nominal", 0)
    calm = Stage(tmp_path / "calm", a_pair(method), workers)
    calm.play()
    stage = odd(tmp_path / "run", a_pair(method), workers, rollout=str(first), shift=0.001)
    stage.play()
    assert stage.ledger.done
    assert fingerprints(tmp_path / "run") == fingerprints(tmp_path / "calm")
    (failed,) = [each for each in outcomes(tmp_path / "run", first) if each[0] != "recorded"]
    assert failed == ("its trajectory is not the one that its repetition gave", "system")
    for each in (calm, stage):
        each.journal.close()


def fingerprints(directory: Path) -> list[tuple[str, int, str]]:
    """Return the sha256 of every rollout."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        query = "SELECT problem, test, variant, sha256 FROM rollouts ORDER BY 1, 2, 3"
        return connection.execute(query).fetchall()


def test_a_rollout_that_always_lacks_its_objective_ends_the_campaign_with_its_history(tmp_path: Path) -> None:
    stage = odd(tmp_path, a_pair("paper"), value=1.7e308, times=9)
    with pytest.raises(PerfboundError, match=r"sim_gap.3.true.0 failed 2 times.*beyond 1e\+100"):
        stage.play()
    stage.journal.close()


def verify(directory: Path) -> dict[str, str]:
    """Return the failed checks."""
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None)
    return {check.name: check.detail for check in found.checks.lines() if check.status == "failed"}


# Databases that have such a rollout


@pytest.fixture
def stuck(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The run directory of a campaign that an older perfbound stopped in: two time grids in one pair."""
    stage = odd(tmp_path / "run", a_pair("rigorous"), shift=0.001, held=str(BEFORE))
    with monkeypatch.context() as older:
        older.setattr("perfbound.orchestrator.campaign.admission.Admission.check", lambda *_: "same")
        # Both are recorded while an earlier test is open, so that neither is observed.
        stage.play(lambda: len(stage.ledger.series["sim_gap"].rollouts.get(ODD.test, ())) == 2)
    stage.journal.close()
    return tmp_path / "run"


def resumed(directory: Path) -> Ledger:
    """Resume a campaign with puppets, to its certificate."""
    journal = Journal.open(directory)
    with closing(journal):
        ledger = Ledger(directory, journal)
        ledger.replay()
        ledger.check_files(journal)
        puppets = Puppets(journal.header.spec, 3)
        service = Service(ledger, journal, puppets, None, [], resumed=False)
        puppets.start(journal.header.run, service.inbox.put)
        service.run()
        certify(directory, ledger)
    return ledger


def test_a_discarded_rollout_is_simulated_again_and_the_certificate_names_it(stuck: Path) -> None:
    with pytest.raises(PerfboundError, match="the time grids differ"):
        resumed(stuck)
    found = discard_rollout(stuck, str(ODD), "its grid is that of\nanother simulator")
    assert (stuck / found.path).is_file()
    ledger = resumed(stuck)
    certificate = files.read(stuck)
    assert certificate is not None
    (named,) = [each for each in certificate.predicate.assumptions if each.id == "discarded_1"]
    assert named.values == {"rollout": str(ODD), "sha256": found.sha256, "reason": found.reason}
    assert str(ODD) in named.detail
    assert r"its grid is that of\nanother simulator" in named.detail
    (repeatable,) = [each for each in certificate.predicate.assumptions if each.id == "reproducible_rollouts"]
    assert repeatable.status == "refuted", "the same seed gave two trajectories"
    assert all("discarded_1" in claim.assumptions for claim in certificate.predicate.claims)
    assert observed_discards(ledger) == [found]
    assert verify(stuck) == {}
    with pytest.raises(PerfboundError, match="has finished"):
        discard_rollout(stuck, str(ODD), "again")


def test_a_valid_rollout_is_never_discarded(stuck: Path) -> None:
    with pytest.raises(PerfboundError, match="its test is observed"):
        discard_rollout(stuck, "sim_gap.0.true.0", "unwelcome")
    with closing(Journal.open(stuck)) as journal:
        ledger = Ledger(stuck, journal)
        ledger.replay()
        valid = [
            fact
            for series in ledger.series.values()
            for facts in series.rollouts.values()
            for fact in facts
            if fact.rollout[:2] != ODD[:2]
        ]
    for fact in valid:
        with pytest.raises(PerfboundError, match="the objective can be computed from it"):
            discard_rollout(stuck, str(fact.rollout), "unwelcome")
    for name, message in (("sim_gap.99.true.0", "no such rollout"), ("sim_gap", "is no rollout")):
        with pytest.raises(PerfboundError, match=message):
            discard_rollout(stuck, name, "unwelcome")
    with pytest.raises(PerfboundError, match="--reason: has 0 characters"):
        discard_rollout(stuck, str(ODD), "  ")


def test_a_discard_that_is_killed_before_its_commit_leaves_nothing(
    stuck: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents_of(stuck)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as crash:
        crash.setattr(store_discard, "unguarded", killed)
        with pytest.raises(KeyboardInterrupt):
            discard_rollout(stuck, str(PARTNER), "killed")
    assert list((stuck / "discarded").iterdir()) != []
    assert contents_of(stuck) == before
    kept = discard_rollout(stuck, str(ODD), "then the other one").path
    resumed(stuck)
    assert [str(path.relative_to(stuck)) for path in (stuck / "discarded").iterdir()] == [kept]
    assert verify(stuck) == {}


def contents_of(directory: Path) -> list[tuple[Any, ...]]:
    """Return the rows of the facts that a discard moves, and the triggers that protect them."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        queries = ("SELECT * FROM rollouts", "SELECT * FROM discards", "SELECT sql FROM sqlite_master ORDER BY name")
        return [row for query in queries for row in connection.execute(query).fetchall()]


@pytest.mark.integration
def test_a_discard_refuses_a_campaign_that_runs_and_one_that_finished_meanwhile(
    stuck: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with campaign_lock(stuck), pytest.raises(PerfboundError, match=facts("another orchestrator running campaign")):
        discard_rollout(stuck, str(ODD), "in mid-run")
    discard_rollout(stuck, str(ODD), "before the end")

    @contextmanager
    def at_last(directory: Path) -> Iterator[None]:
        resumed(directory)
        yield

    monkeypatch.setattr(run_discard, "campaign_lock", at_last)
    with pytest.raises(PerfboundError, match="has finished"):
        discard_rollout(stuck, "sim_gap.0.true.0", "too late")


def test_a_rollout_that_is_discarded_is_no_suspect_and_contradicts_nothing(stuck: Path) -> None:
    with closing(sqlite3.connect(stuck / DATABASE)) as connection, connection:
        ((liar,),) = connection.execute(
            "SELECT worker FROM outcomes WHERE outcome = 'recorded' AND rollout = ?", [str(ODD)]
        ).fetchall()
        values = [("outvoted", "sim_gap.0.true.0", liar), ("reviewed", str(ODD), "another")]
        connection.executemany("INSERT INTO opinions VALUES (NULL, ?, ?, 1, ?, 'other', 0.0, NULL)", values)
    assert read.contradicted(stuck) == [str(ODD)]
    discard_rollout(stuck, str(ODD), "odd")
    assert read.contradicted(stuck) == []
    with closing(sqlite3.connect(stuck / DATABASE)) as connection, connection:
        connection.execute("DROP TRIGGER opinions_no_delete")
        connection.execute("DELETE FROM opinions WHERE kind = 'reviewed'")
    with closing(Journal.open(stuck)) as journal:
        assert ODD not in journal.attempts.suspects()


@pytest.mark.rest
def test_both_rollouts_of_a_pair_may_be_discarded(stuck: Path) -> None:
    discard_rollout(stuck, str(PARTNER), "one of the two")
    discard_rollout(stuck, str(ODD), "the other one")
    resumed(stuck)
    assert verify(stuck) == {}


@pytest.mark.parametrize(
    ("spoil", "check"),
    [
        ("file", "files"),
        ("reason", "chain"),
        ("valid", "observations"),
        ("row", "database"),
    ],
)
def test_verify_finds_a_false_discard(stuck: Path, monkeypatch: pytest.MonkeyPatch, spoil: str, check: str) -> None:
    kept = discard_rollout(stuck, str(ODD), "its grid")
    if spoil == "valid":  # a perfbound that discards what its owner does not like
        monkeypatch.setattr("perfbound.orchestrator.run.discard._refuse_valid", lambda *_: None)
        discard_rollout(stuck, "sim_gap.2.nominal.0", "unwelcome")
    resumed(stuck)
    if spoil == "file":
        (stuck / kept.path).unlink()
    if spoil == "reason":
        path = stuck / files.CERTIFICATE
        path.write_text(path.read_text().replace("its grid", "its grip"))
    if spoil == "row":
        with closing(sqlite3.connect(stuck / DATABASE)) as connection:
            connection.executescript("DROP TRIGGER discards_no_update; UPDATE discards SET reason = 'none'")
    assert check in verify(stuck)


@pytest.mark.parametrize(("end", "remedy"), [(0.0, "one sample at 0 s"), (1.9, "")])
def test_a_horizon_for_one_sample_is_to_be_removed(end: float, remedy: str) -> None:
    samples = np.array([[0.0, 1.0], [end, 1.0]])[: 1 if end == 0 else 2]
    with pytest.raises(UnusableTrajectoryError) as refused:
        check_whole(Trajectory(("t", "y"), samples), ("t", "y"), 5.0)
    assert "the horizon is 5 s" in str(refused.value)
    assert remedy in str(refused.value)
    assert ("remove" in str(refused.value)) == bool(remedy)

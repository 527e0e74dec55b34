"""A campaign in batches: nothing depends on the order of results, on failures within batches, or on restarts."""

import hashlib
import json
import random
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.admission import admit_either, scored
from perfbound.orchestrator.campaign.ledger import Ledger, Scored, observed_rollouts
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.certificate.verify.resimulate import Resimulation, finding
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.collect.fresh_starts import FreshStarts
from perfbound.orchestrator.report.collect.violations import ranked_tests, violating_starts
from perfbound.orchestrator.report.rollout.load import load_recorded
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.changes import ChangeReader
from perfbound.orchestrator.store.export import table_rows
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.robustness import read_number_of_rollouts, read_values, read_violations
from perfbound.schemas.batch import BatchRequest, work_of
from perfbound.schemas.errors import JournalError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import Attempt, FileId, RolloutId
from perfbound.schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact
from perfbound.schemas.result.facts import RECORDED, Header, ObservationFact, RolloutFact
from perfbound.schemas.trajectory.batch import Batch, with_failures
from perfbound.schemas.trajectory.trajectory import Trajectory, read_mcap
from perfbound.workers.batch import run_on
from perfbound.workers.systems import load_system
from perfbound.workers.systems.base import SystemUnderTest
from tests.fakes.finished import KERNEL, a_list, a_pair
from tests.tampering import editing

TABLE = {
    "name": "batches",
    "seed": 5,
    "specification": "always (value >= 0.2)",
    "clip": [-1.0, 1.0],
    "horizon": 0.3,
    "recheck": 0,
    "system": {"name": "test-function"},
    "space": {"z1": {"low": 0.0, "high": 4.0}, "z2": {"low": 0.0, "high": 3.0}},
}


def config(**changes: Any) -> CampaignConfig:
    return CampaignConfig.model_validate_json(json.dumps({**TABLE, **changes}))


def sampled(batch: int, tests: int = 50, **changes: Any) -> CampaignConfig:
    problem = {"name": "robustness", "method": "sample", "max_tests": tests}
    claims = [{"quantity": "failure_probability", "delta": 0.05}, {"quantity": "mean", "delta": 0.05}]
    return config(batch=batch, claims=claims, problems=[problem], **changes)


def planned(batch: int, name: str = "robustness", **changes: Any) -> CampaignConfig:
    problem = {"name": name, "method": "kriging", "delta": 0.05, "rkhs_norm": 2.0, "kernel": KERNEL, "max_tests": 24}
    return config(batch=batch, resolution=4, problems=[{**problem, **changes}], composition="single", spot_check=0)


def checked_afresh(**changes: Any) -> CampaignConfig:
    return planned(8).model_copy(update=changes)


class Play:
    """One campaign in this process; `failing` says which places of a batch fail at its first attempt."""

    def __init__(
        self,
        directory: Path,
        chosen: CampaignConfig,
        failing: Callable[[BatchRequest], list[int]],
        system: SystemUnderTest | None = None,
    ) -> None:
        self.directory, self._failing = directory, failing
        self.system = system or load_system("test-function")
        self.header = Header.new(chosen, self.system.spec, {}, run="0" * 16)
        self.journal = Journal.create(directory, self.header)
        self.ledger = Ledger(directory, self.journal)
        self._tried: Counter[str] = Counter()
        self._attempts: Counter[str] = Counter()
        self._random = random.Random(str(directory))
        self.requests: list[BatchRequest] = []
        self.of_workers: Counter[str] = Counter()
        """The rollouts that each recorded, two workers in turn."""

    def play(self, *, restarts: bool = False, most: int = 10_000) -> "Play":
        with self.ledger.transaction():
            wanted = self.ledger.outstanding().wanted
        while wanted and most:
            rollout = wanted.pop(self._random.randrange(len(wanted)))
            before = read_number_of_rollouts(self.directory)
            worker = f"worker-{most % 2}"
            payload, found, sha256 = self._simulated(self.ledger, rollout)
            work_id = work_of(self.ledger.request(rollout))
            self._attempts[str(work_id)] += 1
            with self.ledger.transaction():
                work = self.ledger.record(rollout, payload, found, sha256)
                self.journal.attempts.ended(Attempt(work_id, self._attempts[str(work_id)]), worker, RECORDED)
            self.of_workers[worker] += read_number_of_rollouts(self.directory) - before
            wanted = [each for each in [*wanted, *work.wanted] if each not in work.unwanted]
            most -= 1
            if restarts and self._random.random() < 0.3:
                wanted = self.restart()
        return self

    def restart(self) -> list[Any]:
        self.journal.close()
        self.journal = Journal.open(self.directory)
        self.ledger = Ledger(self.directory, self.journal)
        self.ledger.replay()
        self.ledger.check_files(self.journal)
        with self.ledger.transaction():
            return self.ledger.outstanding().wanted

    def _simulated(self, ledger: Ledger, rollout: Any) -> tuple[bytes, Trajectory | Scored, str]:
        request = ledger.request(rollout)
        payload = run_on(self.system, request, lambda _: None)
        if isinstance(request, BatchRequest):
            self.requests.append(request)
            self._tried[request.rollout] += 1
            if len(request) > 1 and (places := self._failing(request)):
                payload = with_failures(payload, dict.fromkeys(places, "it diverged"))
        sha256 = hashlib.sha256(payload).hexdigest()
        columns = tuple(each.name for each in self.header.spec.columns)
        admitted = admit_either(request, columns, payload, sha256)
        if isinstance(admitted, Batch):
            assert isinstance(request, BatchRequest)
            return payload, scored(ledger, request, admitted), sha256
        return payload, admitted, sha256

    def certify(self) -> Any:
        assert self.ledger.done
        found = manifest((sha256, path) for _, sha256, path in read.observed(self.directory))
        certificate = issue(self.ledger, found)
        files.write(self.directory, certificate, found.text)
        self.journal.close()
        return certificate


def checked(directory: Path) -> Any:
    return verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks


def none(_: BatchRequest) -> list[int]:
    return []


def some(request: BatchRequest) -> list[int]:
    """The first one, and two more: others in each batch."""
    return sorted({0, request.test % len(request), (7 * request.test + 3) % len(request)})[: len(request) - 1]


@contextmanager
def played(directory: Path, chosen: CampaignConfig, **keys: Any) -> Iterator[Play]:
    failing, system = keys.pop("failing", none), keys.pop("system", None)
    directory.mkdir()
    found = Play(directory, chosen, failing, system).play(**keys)
    try:
        yield found
    finally:
        found.journal.close()


CAMPAIGNS = {
    "sample, blocks": sampled(16),
    "sample, one block": sampled(64),
    "kriging, blocks": planned(8),
    "kriging, blocks of replicates": planned(8, replicates=3),
    "kriging, batches within a test": planned(4, replicates=10, max_tests=3),
    "risk, blocks": planned(8, "true_risk", replicates=2, linearised={"centre": 0.1, "spread": 0.2}),
    "gap, blocks": config(
        batch=8,
        resolution=4,
        composition="sum",
        spot_check=0,
        gap={"kind": "signal_sup", "column": "value"},
        problems=[
            {"name": "nominal_robustness", "method": "rigorous", "delta": 0.05, "alpha": 0.5, "rkhs_norm": 2.0}
            | {"kernel": KERNEL, "noise_scale": 0.0, "max_tests": 3},
            {"name": "sim_gap", "method": "kriging", "delta": 0.05, "rkhs_norm": 2.0, "kernel": KERNEL}
            | {"max_tests": 12, "replicates": 2},
        ],
    ),
    "spot check, blocks and follow-ups": checked_afresh(spot_check=21, spot_check_followups=9),
    "spot check, blocks of replicates": checked_afresh(spot_check=21, spot_check_followups=9, spot_replicates=3),
    "spot check, batches within a start": checked_afresh(spot_check=5, spot_check_followups=9, spot_replicates=20),
    "spot check of a gap": a_pair("rigorous", batch=8, spot_check=20, spot_check_followups=10, spot_replicates=2),
    "rigorous, batches within a test": a_pair("rigorous", batch=4, replicates=3),
    "scenario, batches within a test": a_list(batch=3),
}
REDUCED = {
    "sample, the worst": sampled(2, 200, keep="worst 5"),
    "sample, failures": sampled(16, keep="failures"),
    "risk, the worst": planned(8, "true_risk", replicates=2, linearised={"centre": 0.1, "spread": 0.2}).model_copy(
        update={"keep": "worst 3"}
    ),
    "kriging, the worst within a test": planned(4, replicates=10, max_tests=3).model_copy(update={"keep": "worst 2"}),
    "scenario, the worst within a test": a_list(batch=3, keep="worst 4"),
    "the worst, but a whole spot check": checked_afresh(spot_check=21, spot_check_followups=9, keep="worst 3"),
}
"""Campaigns that keep not all samples."""


def numbers(play: Play) -> Any:
    """What the campaign has decided, without the files in which its rollouts are."""
    return {
        name: (
            series.link,
            series.files,
            list(series.observations),
            list(series.each),
            list(series.nodes),
            series.counts,
        )
        for name, series in play.ledger.series.items()
    } | {"bounds": [series.last_bound for series in play.ledger.series.values()]}


@pytest.mark.parametrize("name", ["sample, blocks", "kriging, blocks of replicates"])
def test_what_a_worker_recorded_is_counted_in_rollouts_and_not_in_batches(name: str, tmp_path: Path) -> None:
    """The retry of a rollout that failed in its batch may be another worker's, also that of the first one."""
    with played(tmp_path / "a", CAMPAIGNS[name], failing=some) as play:
        expected = dict(play.of_workers)
        assert sum(expected.values()) > len(play.requests)
        assert {worker: rollouts for worker, rollouts, _ in read_progress(play.directory).workers} == expected
        rows = Collector(play.directory).refresh().workers
        assert {row.name: row.rollouts for row in rows} == expected
        columns, exported = table_rows(play.directory, "rollouts")
        place = [column.name for column in columns].index("worker")
        assert Counter(row[place] for row in exported) == expected


def test_a_verification_counts_rollouts_as_rollouts_and_files_as_files(tmp_path: Path) -> None:
    with played(tmp_path / "a", CAMPAIGNS["sample, blocks"], failing=some) as play:
        play.certify()
        found, number = checked(play.directory).found, len(list(play.directory.rglob("*.mcap")))
    assert found["trajectories"].detail == f"{number} files"
    assert found["requests"].detail == "50 rollouts"
    assert found["database"].detail.startswith("50 tests, 50 rollouts, 50 observations, ")
    again = tuple(Resimulation(FileId.parse(f"a.{test}.b.0.16"), bitwise=True, difference=0.0) for test in (0, 16))
    assert finding(again, 1234).startswith("2 of 1,234 files, bitwise the same: ")


@pytest.mark.parametrize("name", [*CAMPAIGNS, *REDUCED])
def test_neither_order_nor_failures_nor_restarts_change_what_is_decided(name: str, tmp_path: Path) -> None:
    chosen = {**CAMPAIGNS, **REDUCED}[name]
    with played(tmp_path / "a", chosen) as one, played(tmp_path / "b", chosen, failing=some, restarts=True) as other:
        assert one.ledger.done
        assert other.ledger.done
        assert numbers(one) == numbers(other)
        assert observed_rollouts(one.ledger) <= sum(len(each) for each in one.requests)  # some come after the stop
        replayed = numbers(one)
        one.restart()
        assert numbers(one) == replayed


@pytest.mark.parametrize("name", [*CAMPAIGNS, *REDUCED])
def test_its_certificate_is_verified(name: str, tmp_path: Path) -> None:
    with played(tmp_path / "run", {**CAMPAIGNS, **REDUCED}[name], failing=some) as play:
        play.certify()
    checks = checked(tmp_path / "run")
    assert [(line.name, line.detail) for line in checks.lines() if line.status == "failed"] == []


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_an_observation_is_that_of_its_trajectories_one_by_one(name: str, tmp_path: Path) -> None:
    with played(tmp_path / "run", CAMPAIGNS[name], failing=some) as play:
        facts = list(recorded_facts.read_facts(play.journal._connection))
        rollouts = [fact for fact in facts if isinstance(fact, RolloutFact)]
        trajectories = {fact.rollout: play.ledger.recorded.read(fact) for fact in rollouts}
        for fact in rollouts:
            assert fact.robustness == play.ledger.observer.robustness(trajectories[fact.rollout])
            assert fact.seed == play.ledger.deciders[fact.rollout.problem].seed(fact.rollout)
        for observed in (each for each in facts if isinstance(each, ObservationFact)):
            test = (observed.problem, observed.test)
            if test[0] not in play.ledger.plans:
                continue
            mine = {each[2:]: trajectories[each] for each in sorted(trajectories) if each[:2] == test}
            assert observed.observation == play.ledger.observer.observe(play.ledger.plans[test[0]], mine)


def test_a_batch_is_one_file_and_one_fact(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16)) as play:
        facts = list(play.journal.facts())
        sizes = [len(fact) for fact in facts if isinstance(fact, BatchFact)]
        assert sorted(sizes) == [2, 16, 16, 16]
        blocks = [fact for fact in facts if isinstance(fact, BlockProposalFact | BlockObservationFact)]
        assert len(blocks) == 8
        assert len(list((tmp_path / "run" / "trajectories").rglob("*.mcap"))) == 4


def test_failures_by_chance_change_files_and_what_is_said_of_them_alone(tmp_path: Path) -> None:
    """Which attempt a retry replaced is evidence: a certificate without that would hide it."""
    found = []
    for name, failing in (("a", none), ("b", some)):
        with played(tmp_path / name, CAMPAIGNS["sample, blocks"], failing=failing) as play:
            predicate = play.certify().predicate.model_dump(mode="json")
        del predicate["evidence"]["manifest_sha256"]
        said = {each["id"]: each for each in predicate.pop("assumptions")}
        for claim in predicate["claims"]:
            del claim["refuted"]  # by that assumption
        found.append((predicate, said))
    (one, calm), (other, failed) = found
    assert one == other
    assert {name for name in calm if calm[name] != failed[name]} == {"reproducible_rollouts"}


def test_a_rollout_that_failed_is_made_again_alone(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16), failing=lambda request: [0, 5] if len(request) > 5 else [0]) as play:
        again = [each for each in play.requests if len(each) == 1]
        assert sorted(each.test for each in again) == [0, 5, 16, 21, 32, 37, 48]
        assert all(each.seeds[0] == play.ledger.deciders["robustness"].seed(each.rollouts[0]) for each in again)


@pytest.mark.parametrize("failing", [none, some])
def test_readers_find_every_rollout_once(tmp_path: Path, failing: Callable[[BatchRequest], list[int]]) -> None:
    with played(tmp_path / "run", sampled(16), failing=failing) as play:
        assert play.ledger.arrived == 50
        values = {fact.rollout: fact.robustness for fact in recorded_facts.observed_rollouts(tmp_path / "run")}
    assert len(values) == 50
    listed = [value for each in read_values(tmp_path / "run", "true", ["robustness"]) for value in each.robustness]
    assert listed == [values[each] for each in sorted(values)]
    found = read_violations(tmp_path / "run", "true")
    below = [value for value in values.values() if value is not None and value < 0]
    assert (found.rollouts, found.violations) == (50, len(below))
    assert found.starts == 50
    assert found.violating_starts == len(below)
    worst = min(values, key=lambda each: (values[each] or 0.0, each))
    assert (found.least, found.rollout) == (values[worst], str(worst))
    header = read.stored_header(tmp_path / "run")
    ranked = sorted(values, key=lambda each: (values[each], each))
    first = next(each for each in sorted(values) if (values[each] or 0.0) < 0)
    assert [each.rollout for each in ranked_tests(tmp_path / "run", header)] == [
        str(each) for each in (ranked[0], first, ranked[24], ranked[-1])
    ]
    below_zero = [each for each in recorded_facts.observed_rollouts(tmp_path / "run") if each.violates]
    assert set(ChangeReader(tmp_path / "run").read().violations) == set(below_zero)
    _, rows = table_rows(tmp_path / "run", "counterexamples")
    assert sorted(str(row[0]) for row in rows) == sorted(str(each.rollout) for each in below_zero)
    starts = violating_starts(tmp_path / "run", header)
    assert sorted((each.test, each.worst, each.violations) for each in starts) == [
        (each.test, values[each], 1) for each in sorted(values) if (values[each] or 0.0) < 0
    ]


def test_the_report_finds_the_fresh_starts_of_blocks(tmp_path: Path) -> None:
    found = FreshStarts()
    with played(tmp_path / "run", CAMPAIGNS["spot check, blocks of replicates"], failing=some) as play:
        for fact in play.journal.facts():
            found.add(fact)
        starts, first = found.latest()
        check, series = play.ledger.closing.spot_check, play.ledger.series["spot_check"]
        assert check is not None
        assert starts == dict(enumerate(check.starts))
        assert first == dict(enumerate(series.each[: len(starts)]))


def test_the_course_of_a_bound_is_the_same_from_the_database(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(5, tests=120)) as play:
        course = play.ledger.accounts["robustness"].progress.course
    assert read_progress(tmp_path / "run").problems[0].course == course
    assert 10 < len(course) < 120 // 5, "a block without a marked test is left out"


def test_a_block_ends_at_the_counterexample_that_the_report_shows(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16, until_counterexample=True)) as play:
        found = play.certify().predicate.counterexample
    report = Collector(tmp_path / "run").refresh()
    assert found is not None
    assert report.counterexample is not None
    assert report.counterexample.test == found.test
    assert report.violations >= len(report.counterexamples) > 0


@pytest.mark.parametrize("chosen", [CAMPAIGNS["sample, blocks"], REDUCED["sample, the worst"]])
@pytest.mark.parametrize("failing", [none, some])
def test_a_damaged_batch_comes_back(
    tmp_path: Path, failing: Callable[[BatchRequest], list[int]], chosen: CampaignConfig
) -> None:
    with played(tmp_path / "run", chosen, failing=failing) as play:
        certificate = play.certify()
        kept = {path: path.read_bytes() for path in (tmp_path / "run" / "trajectories").rglob("*.mcap")}
        for place, (path, content) in enumerate(kept.items()):
            if place % 2:
                path.unlink()
            else:
                path.write_bytes(content[:-1])
        wanted = play.restart()
        assert wanted
        play.play()
        assert {path: path.read_bytes() for path in kept} == kept
        assert play.certify() == certificate


@pb.system(parameters={"z": pb.Parameter(0, 9)}, columns={"y": ""}, step=0.1, vectorised=True, batch_is_the_unit=True)
def coupled(z: Any, *, seeds: Any, horizon: float) -> Any:
    """The size of the batch shows in the samples."""
    return len(seeds) + z[:, np.newaxis] + np.arange(round(horizon / 0.1) + 1)


def test_where_the_batch_is_the_unit_a_repeated_rollout_is_repeated_within_it(tmp_path: Path) -> None:
    """Also one of the recheck, which the review asks for once more, or a replay opens."""
    chosen = sampled(16, specification="always (y >= 1)", recheck=7, space={"z": {"low": 0.0, "high": 9.0}})
    with played(tmp_path / "run", chosen, system=coupled) as play:
        assert list(play.ledger.series["recheck"].observations) == [1.0] * 7
        for test in range(7):
            rollout = RolloutId("recheck", test, "nominal", 0)
            fact = play.journal.rollout(rollout)
            recorded = read_mcap((play.directory / fact.path).read_bytes()).request
            assert recorded["within"]
            assert play.ledger.request_again(rollout).model_dump(mode="json") == recorded
            assert load_recorded(play.directory, str(rollout)).request.model_dump(mode="json") == recorded


EDITS = {
    "a robustness": ("rollouts", "robustness_of"),
    "a seed": ("rollouts", "seeds"),
    "a digest": ("rollouts", "digests"),
    "a start": ("tests", "starts"),
    "an observation": ("observations", "y_of"),
    "a contribution": ("observations", "each_of"),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_edited_column_is_found(name: str, tmp_path: Path) -> None:
    table, column = EDITS[name]
    with played(tmp_path / "run", sampled(16)) as play:
        play.certify()
    with editing(tmp_path / "run") as database:
        (content,) = database.execute(f"SELECT {column} FROM {table} WHERE test = 16").fetchone()
        changed = bytearray(content)
        changed[8:16] = np.float64(0.123).tobytes() if column != "seeds" else bytes([1] * 8)
        database.execute(f"UPDATE {table} SET {column} = ? WHERE test = 16", [bytes(changed)])
    assert "failed" in {line.status for line in checked(tmp_path / "run").lines()}
    if column not in ("robustness_of",):  # which follows from the trajectories: no link of the chain has it
        with pytest.raises(JournalError, match="contradict each other"):
            Play.restart(_reopened(tmp_path / "run", play))


@pytest.mark.parametrize("change", ["violations = 0", "rollouts = 15", "robustness = 0.5"])
def test_a_count_that_is_not_that_of_its_rollouts_is_found(change: str, tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16)) as play:
        play.certify()
    with editing(tmp_path / "run") as database:
        database.execute(f"UPDATE rollouts SET {change} WHERE violations > 0")
    assert "database" in {line.name for line in checked(tmp_path / "run").lines() if line.status == "failed"}
    with pytest.raises(JournalError, match="are not those of its values"):
        Play.restart(_reopened(tmp_path / "run", play))


def test_of_equal_violations_the_first_one_is_the_worst(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16, clip=[-0.01, 1.0]), failing=some):
        values = {fact.rollout: fact.robustness for fact in recorded_facts.observed_rollouts(tmp_path / "run")}
    least = [each for each in sorted(values) if values[each] == -0.01]
    assert len(least) > 1
    assert read_violations(tmp_path / "run", "true").rollout == str(least[0])


def _reopened(directory: Path, play: Play) -> Play:
    play.directory, play.journal = directory, Journal.open(directory)
    return play


def test_a_batch_of_another_campaign_is_found(tmp_path: Path) -> None:
    for name, seed in (("run", 5), ("other", 6)):
        with played(tmp_path / name, sampled(16, seed=seed)) as play:
            play.certify()
    path = next((tmp_path / "run" / "trajectories").rglob("robustness.16.*"))
    shutil.copy(tmp_path / "other" / path.relative_to(tmp_path / "run"), path)
    assert [line.name for line in checked(tmp_path / "run").lines() if line.status == "failed"] == ["files"]

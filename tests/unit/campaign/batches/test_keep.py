"""The key `keep`: which rollouts keep their samples, what the others leave, and that nothing else can pass for it."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.campaign.admission import admit_batch
from perfbound.orchestrator.campaign.ledger import Scored
from perfbound.orchestrator.campaign.series import Kept
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.report.rollout.load import load_recorded
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.schemas.errors import EvidenceError, PerfboundError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.block_facts import BatchFact
from perfbound.schemas.trajectory.batch import Batch, encode_batch, with_failures
from perfbound.schemas.trajectory.reduced import Reduced, read_stored
from tests.unit.campaign.batches.test_batched_campaign import (
    CAMPAIGNS,
    REDUCED,
    TABLE,
    Play,
    checked,
    none,
    numbers,
    played,
    sampled,
)

WORST = REDUCED["sample, the worst"]


@given(
    st.lists(st.lists(st.sampled_from([-1.0, -0.5, 0.0, 0.25, 1.0, 2.0, 3.5]), min_size=1, max_size=6), max_size=30),
    st.integers(1, 8),
    st.integers(1, 5),
)
def test_the_worst_of_all_are_among_those_that_are_kept(blocks: list[list[float]], most: int, window: int) -> None:
    kept, found = Kept(f"worst {most}"), list[float]()
    for block, _values in enumerate([*blocks, *[[]] * window]):
        if block < len(blocks):
            kept.propose(block)
        if (closed := block - window + 1) >= 0 and closed < len(blocks):
            places = kept.places(closed, np.array(blocks[closed]))
            assert places == sorted(places or [])
            assert len(places or []) <= most
            found += [blocks[closed][each] for each in places or []]
            kept.observe(closed, np.array(blocks[closed]), len(places or []))
    everything = sorted(value for values in blocks for value in values)
    assert sorted(found)[:most] == everything[:most]
    assert kept.number == len(found)


def test_failures_are_kept_as_they_are_counted() -> None:
    """A robustness of 0 counts as a violation of the sample."""
    kept = Kept("failures")
    kept.propose(0)
    assert kept.places(0, np.array([0.5, 0.0, -1.0, np.nan, 1e-300])) == [1, 2]


def test_a_rollout_that_failed_keeps_nothing() -> None:
    kept = Kept("worst 3")
    kept.propose(0)
    assert kept.places(0, np.array([0.5, np.nan, -1.0])) == [0, 2]


def batches(play: Play) -> list[tuple[BatchFact, Reduced]]:
    facts = [fact for fact in play.journal.facts() if isinstance(fact, BatchFact)]
    read = [(fact, read_stored((play.directory / fact.path).read_bytes()).batch) for fact in facts]
    return [(fact, batch) for fact, batch in read if isinstance(batch, Reduced)]


@pytest.mark.parametrize(
    ("reduced", "whole"), [("sample, failures", "sample, blocks"), ("scenario, the worst within a test",) * 2]
)
def test_what_is_kept_decides_nothing(reduced: str, whole: str, tmp_path: Path) -> None:
    chosen = CAMPAIGNS.get(whole) or REDUCED[whole].model_copy(update={"keep": "all"})
    with played(tmp_path / "a", REDUCED[reduced]) as one, played(tmp_path / "b", chosen) as other:
        assert one.header.config_sha256 == other.header.config_sha256
        assert numbers(one) == numbers(other)


@pytest.mark.parametrize("name", REDUCED)
def test_the_files_have_what_their_key_says(name: str, tmp_path: Path) -> None:
    with played(tmp_path / "run", REDUCED[name]) as play:
        values, kept = list[float](), list[float]()
        for fact, batch in batches(play):
            assert fact.robustness is not None
            assert fact.kept == list(batch.kept)
            assert [each or bytes(32) for each in batch.digests] == [bytes(each) for each in fact.digests]
            values += fact.robustness[fact.succeeded].tolist()
            kept += fact.robustness[fact.kept].tolist()
            if batch.samples is not None:
                assert batch.samples.values.shape[1] == len(batch.kept)
        count = play.ledger.accounts[play.ledger.config.problems[0].name].kept.number
    assert 0 < len(kept) < len(values)
    assert count == len(kept)
    keep = play.ledger.config.keep
    if keep == "failures":
        assert sorted(kept) == sorted(value for value in values if value <= 0)
    else:
        most = int(keep.split()[1])
        assert sorted(kept)[:most] == sorted(values)[:most]


def test_neither_order_nor_restarts_change_a_file(tmp_path: Path) -> None:
    with played(tmp_path / "a", WORST) as one, played(tmp_path / "b", WORST, restarts=True) as other:
        assert one.certify() == other.certify()
    for name in ("manifest.sha256", "certificate.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_certificate_says_what_is_left(tmp_path: Path) -> None:
    with played(tmp_path / "run", WORST) as play:
        found = {each.id: each for each in play.certify().predicate.assumptions}
        kept = play.ledger.accounts["robustness"].kept.number
    assert found["scores_as_computed"].values == {"keep": "worst 5", "kept": kept, "reduced": 200 - kept}
    assert "recomputed from those whose samples were kept" in found["workers_honest"].detail
    said = checked(tmp_path / "run").found["observations"].detail
    assert said == f"200 tests; the robustness of {200 - kept} rollouts without samples is taken as recorded"


def test_a_damaged_file_does_not_come_back_with_other_samples(tmp_path: Path) -> None:
    with played(tmp_path / "run", WORST) as play:
        next((tmp_path / "run" / "trajectories").rglob("*.mcap")).unlink()
        (rollout,) = play.restart()
        payload, found, sha256 = play._simulated(play.ledger, rollout)
        assert isinstance(found, Scored)
        assert isinstance(found.batch, Batch)
        request = play.ledger.request(rollout)
        other = Batch(found.batch.columns, found.batch.time, found.batch.values + 1e-12)
        changed = encode_batch(other, request=request.model_dump(mode="json"), metadata=request.metadata)
        with pytest.raises(PerfboundError, match="does not follow from its seed alone"), play.ledger.transaction():
            play.ledger.record(rollout, changed, replace(found, batch=other), hashlib.sha256(changed).hexdigest())
        with play.ledger.transaction():
            play.ledger.record(rollout, payload, found, sha256)
        assert play.ledger.done


def test_a_damaged_file_does_not_come_back_where_a_rollout_fails_now(tmp_path: Path) -> None:
    with played(tmp_path / "run", sampled(16, keep="worst 5")) as play:
        next((tmp_path / "run" / "trajectories").rglob("*.mcap")).unlink()
        (rollout,) = play.restart()
        payload, found, _ = play._simulated(play.ledger, rollout)
        failed = with_failures(payload, {1: "it diverged"})
        with pytest.raises(PerfboundError, match="does not follow from its seed alone"), play.ledger.transaction():
            play.ledger.record(rollout, failed, found, hashlib.sha256(failed).hexdigest())


class Dishonest(Play):
    """An orchestrator that gives rollouts that it does not keep a better robustness."""

    def _simulated(self, ledger: Any, rollout: Any) -> Any:
        payload, found, sha256 = super()._simulated(ledger, rollout)
        if isinstance(found, Scored) and found.scores.robustness is not None:
            values = found.scores.robustness
            better = np.where(values == np.nanmin(values), values, np.minimum(values + 0.125, 1.0))
            found = replace(found, scores=found.scores._replace(robustness=better))
        return payload, found, sha256


@pytest.mark.integration
def test_a_forged_robustness_is_found_by_a_second_simulation(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    play = Dishonest(tmp_path / "run", sampled(16, keep="worst 1"), none).play()
    play.certify()
    assert "failed" not in {line.status for line in checked(tmp_path / "run").lines()}
    again = verify_certificate(tmp_path / "run", key=None, again=4, report=lambda *_: None).checks
    found = again.found["resimulation"]
    assert (found.status, "differs by up to 0.125" in found.detail) == ("failed", True)


def test_a_robustness_of_samples_that_are_kept_is_recomputed(tmp_path: Path) -> None:
    class Bold(Dishonest):
        def _simulated(self, ledger: Any, rollout: Any) -> Any:
            payload, found, sha256 = Play._simulated(self, ledger, rollout)
            if isinstance(found, Scored) and found.scores.robustness is not None:
                found = replace(found, scores=found.scores._replace(robustness=found.scores.robustness + 1e-6))
            return payload, found, sha256

    (tmp_path / "run").mkdir()
    Bold(tmp_path / "run", sampled(16, keep="worst 1"), none).play().certify()
    failed = {line.name: line.detail for line in checked(tmp_path / "run").lines() if line.status == "failed"}
    assert "other scores than its samples give" in failed["trajectories"]


def test_samples_of_bad_rollouts_cannot_be_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run").mkdir()
    with monkeypatch.context() as patched:
        patched.setattr(Kept, "places", lambda *_: [])
        Play(tmp_path / "run", sampled(16, keep="failures"), none).play().certify()
    failed = {line.name: line.detail for line in checked(tmp_path / "run").lines() if line.status == "failed"}
    assert "samples of other rollouts than `keep` leaves" in failed["observations"]


def test_a_worker_cannot_send_a_reduced_batch(tmp_path: Path) -> None:
    with played(tmp_path / "run", WORST, most=0) as play:
        ledger = play.ledger
        with ledger.transaction():
            rollout = ledger.outstanding().wanted[0]
        payload, found, sha256 = play._simulated(ledger, rollout)
        with ledger.transaction():
            ledger.record(rollout, payload, found, sha256)
        (fact, batch), *_ = batches(play)
        sent = (tmp_path / "run" / fact.path).read_bytes()
        request = next(each for each in play.requests if each.rollouts[0] == fact.rollout)
        with pytest.raises(EvidenceError, match="not a batch of trajectories"):
            admit_batch(request, batch.columns, sent, fact.sha256)


def test_a_rollout_that_is_not_kept_has_its_fact_and_no_samples(tmp_path: Path) -> None:
    with played(tmp_path / "run", WORST) as play:
        play.certify()
    facts = recorded_facts.observed_rollouts(tmp_path / "run")
    gone = next(each for each in facts if not each.kept)
    there = next(each for each in facts if each.kept and each.batch)
    found = load_recorded(tmp_path / "run", str(gone.rollout))
    assert found.trajectory is None
    assert "its samples were not kept" in found.damage
    assert load_recorded(tmp_path / "run", str(there.rollout)).trajectory is not None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"keep": "worst 10"}, "keep: what is left of rollouts is packed by batch"),
        ({"keep": "worst 0", "batch": 2}, "keep"),
        ({"keep": "best 3", "batch": 2}, "keep"),
        (
            {"keep": "failures", "batch": 2, "specification": None}
            | {"specifications": [{"name": "a", "formula": "value > 0"}, {"name": "b", "formula": "value > 0.1"}]},
            "keep: only where a test needs the robustness",
        ),
    ],
)
def test_where_it_cannot_be_is_said(changes: dict[str, Any], said: str) -> None:
    table = {**TABLE, "problems": [{"name": "robustness", "method": "sample", "max_tests": 50}], **changes}
    with pytest.raises(ValueError, match=said):
        CampaignConfig.model_validate_json(json.dumps({name: each for name, each in table.items() if each is not None}))

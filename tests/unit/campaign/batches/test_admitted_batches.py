"""The admission of batches whose rollouts are compared in pairs, or measured otherwise than by their robustness."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.admission import Admission, admit_either
from perfbound.orchestrator.campaign.ledger import Scored
from perfbound.schemas.batch import BatchRequest
from perfbound.schemas.errors import UnusableTrajectoryError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.block_facts import BatchFact
from perfbound.schemas.trajectory.batch import Batch
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.batch import run_on
from perfbound.workers.systems.base import SystemUnderTest
from tests.fakes.finished import KERNEL
from tests.unit.campaign.batches.test_batched_campaign import Play, checked, config, none

BOX = {"z": {"low": 0.0, "high": 9.0}}


@pb.system(parameters={"z": pb.Parameter(0, 9)}, columns={"y": ""}, step=0.1, vectorised=True)
def pair(z: Any, *, seeds: Any, horizon: float, variant: str, more: float = 0.0) -> Any:
    """The true system has so many more samples."""
    time = np.linspace(0.0, horizon, 4 + round(more) * (variant == "true"))
    return {"t": time, "y": z[:, np.newaxis] + 0.01 * pb.normal(seeds, len(time))}


@pb.system(parameters={"z": pb.Parameter(0, 9)}, columns={"y": ""}, step=0.1, vectorised=True)
def huge(z: Any, *, seeds: Any, horizon: float, variant: str) -> Any:
    """One rollout of a batch is finite, and its square is not."""
    found = z[:, np.newaxis] + np.zeros(round(horizon / 0.1) + 1)
    found[len(seeds) // 2] = 1e200
    return found


def gaps(*, within_a_test: bool, **changes: Any) -> CampaignConfig:
    """Return a campaign of gaps in blocks of tests, or in several batches of one test."""
    kriging = {"name": "sim_gap", "method": "kriging", "delta": 0.05, "rkhs_norm": 2.0, "kernel": KERNEL}
    nominal = {"name": "nominal_robustness", "method": "rigorous", "delta": 0.05, "alpha": 0.5, "rkhs_norm": 2.0}
    nominal |= {"kernel": KERNEL, "noise_scale": 0.1, "max_tests": 3}
    sizes = {"max_tests": 3, "replicates": 12} if within_a_test else {"max_tests": 12}
    return config(
        batch=8,
        resolution=8,
        composition="sum",
        gap={"kind": "signal_sup", "column": "y"},
        specification="always (y >= 0)",
        space=BOX,
        problems=[kriging | sizes, nominal],
        **{"spot_check": 0, **changes},
    )


@contextmanager
def begun(directory: Path, chosen: CampaignConfig, system: SystemUnderTest) -> Iterator[tuple[Play, list[RolloutId]]]:
    """Begin a campaign; what it wants first is there."""
    directory.mkdir()
    play = Play(directory, chosen, none, system)
    with play.ledger.transaction():
        wanted = play.ledger.outstanding().wanted
    try:
        yield play, wanted
    finally:
        play.journal.close()


def admitted(play: Play, rollout: RolloutId, wanted: list[RolloutId] | None = None) -> str:
    """Simulate, admit and record a batch; return how much its grid has been compared. What follows is `wanted`."""
    request, admission = play.ledger.request(rollout), Admission(play.ledger)
    payload = run_on(play.system, request, lambda _: None)
    sha256 = hashlib.sha256(payload).hexdigest()
    decoded = admit_either(request, admission.columns, payload, sha256)
    found: Trajectory | Scored
    if isinstance(decoded, Batch):
        assert isinstance(request, BatchRequest)
        found, compared = admission.score(rollout, request, decoded)
    else:
        found, compared = decoded, admission.check(rollout, decoded)
    with play.ledger.transaction():
        work = play.ledger.record(rollout, payload, found, sha256)
    if wanted is not None:
        wanted += work.wanted
    return compared


@pytest.mark.parametrize("within_a_test", [False, True])
def test_the_batches_of_a_pair_have_one_grid(tmp_path: Path, *, within_a_test: bool) -> None:
    """What is recorded allows the observation: no campaign stops at it, now and after every resume."""
    for name, more in (("same", 0.0), ("finer", 1.0)):
        system = {"name": "pair", "more": more}
        chosen = gaps(within_a_test=within_a_test, system=system)
        with begun(tmp_path / name, chosen, pair) as (play, wanted):
            nominal, true = [
                next(each for each in wanted if each[::2] == ("sim_gap", variant)) for variant in ("nominal", "true")
            ]
            assert admitted(play, nominal) == "first of a pair"
            if name == "same":
                assert admitted(play, true) == "same"
                continue
            with pytest.raises(UnusableTrajectoryError, match=r"objective of sim_gap\.0\.true\.0 .* one time grid"):
                admitted(play, true)


@pytest.mark.parametrize("within_a_test", [False, True])
def test_replicates_of_two_variants_are_in_one_batch_each(tmp_path: Path, *, within_a_test: bool) -> None:
    chosen = gaps(within_a_test=within_a_test, system={"name": "pair"}, replicates=2)
    with begun(tmp_path / "run", chosen, pair) as (play, wanted):
        play.play()
        facts = [fact for fact in play.journal.recorded() if isinstance(fact, BatchFact)]
        rollouts = [rollout for fact in facts for rollout in fact.rollouts if rollout.problem == "sim_gap"]
        assert len(wanted) <= len(facts) < len(rollouts) / 2
        assert sorted(rollouts) == sorted(set(rollouts))
        play.certify()
    assert [line.detail for line in checked(tmp_path / "run").lines() if line.status == "failed"] == []


def test_fresh_starts_of_a_gap_are_admitted_in_batches(tmp_path: Path) -> None:
    """The batches are compared in pairs, and follow-ups one by one."""
    chosen = gaps(within_a_test=False, system={"name": "pair"}, spot_check=10, spot_check_followups=6)
    with begun(tmp_path / "run", chosen, pair) as (play, wanted):
        compared = {}
        while wanted:
            rollout = wanted.pop(0)
            compared[rollout] = admitted(play, rollout, wanted)
        assert play.ledger.done
        checks = {str(each): found for each, found in compared.items() if each.problem == "spot_check"}
        assert checks["spot_check.0.nominal.0"] == "first of a pair"
        assert checks["spot_check.0.true.0"] == checks["spot_check.8.true.0"] == "same"
        play.certify()
    assert [line.detail for line in checked(tmp_path / "run").lines() if line.status == "failed"] == []


def test_a_value_that_is_too_large_to_be_bounded_is_a_failure(tmp_path: Path) -> None:
    problem = {"name": "maximum", "column": "y", "method": "rigorous", "delta": 0.05, "alpha": 0.1, "replicates": 8}
    problem |= {"noise_scale": 1.0, "rkhs_norm": 2.0, "kernel": KERNEL, "max_tests": 3}
    nothing: dict[str, Any] = {"composition": "single", "clip": None, "specification": None, "spot_check": 0}
    chosen = config(batch=8, resolution=8, space=BOX, problems=[problem], **nothing)
    with (
        begun(tmp_path / "run", chosen, huge) as (play, wanted),
        pytest.raises(UnusableTrajectoryError, match=r"maximum\.0\.true\.4 cannot be computed: .* 1e\+200"),
    ):
        admitted(play, wanted[0])


def test_a_recorded_batch_is_compared_after_a_restart_as_well(tmp_path: Path) -> None:
    chosen = gaps(within_a_test=True, system={"name": "pair"})
    with begun(tmp_path / "run", chosen, pair) as (play, wanted):
        of_test = [each for each in wanted if each.problem == "sim_gap"]
        for rollout in [each for each in of_test if each.variant == "nominal"]:
            admitted(play, rollout)
        (true, *_) = [each for each in play.restart() if each[::2] == ("sim_gap", "true")]
        assert admitted(play, true) == "same"

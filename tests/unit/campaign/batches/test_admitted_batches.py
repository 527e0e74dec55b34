"""The admission of batches whose rollouts are compared in pairs, or measured otherwise than by their robustness."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.admission import Admission, admit_batch
from perfbound.schemas.batch import BatchRequest
from perfbound.schemas.errors import UnusableTrajectoryError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.workers.batch import run_on
from perfbound.workers.systems.base import SystemUnderTest
from tests.fakes.finished import KERNEL
from tests.unit.campaign.batches.test_batched_campaign import Play, config, none

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
        spot_check=0,
        space=BOX,
        problems=[kriging | sizes, nominal],
        **changes,
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


def admitted(play: Play, rollout: RolloutId) -> str:
    """Simulate, admit and record a batch; return how much its grid has been compared."""
    request, admission = play.ledger.request(rollout), Admission(play.ledger)
    assert isinstance(request, BatchRequest)
    payload = run_on(play.system, request, lambda _: None)
    sha256 = hashlib.sha256(payload).hexdigest()
    batch = admit_batch(request, admission.columns, payload, sha256)
    found, compared = admission.score(rollout, request, batch)
    with play.ledger.transaction():
        play.ledger.record(rollout, payload, found, sha256)
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

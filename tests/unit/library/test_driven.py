"""Starts that a rig drove beside those that were asked for, and disturbances that it measured."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.schemas.errors import CampaignError, DefinitionError, PerfboundError
from tests.unit.library.test_study import KEYS, T, curve, finish, rig

SAMPLED = {
    **{key: KEYS[key] for key in ("space", "specification", "horizon", "clip")},
    "method": "sample",
    "max_tests": 4,
}
TOLERANT = rig(tolerance={"x": 0.02})
LIMITED = {**KEYS, "rkhs_norm": 2.0, "clip": (-10, 10)}


def told(tmp_path: Path, made: pb.Rig = TOLERANT, **keys: Any) -> Any:
    return pb.Campaign(made, **(SAMPLED | keys)).ask_tell(tmp_path / "run")


def test_the_start_that_was_driven_is_the_record(tmp_path: Path) -> None:
    with told(tmp_path) as study:
        request = study.ask()
        x = request.start["x"]
        study.tell(request, curve(request), start={"x": x + 0.015})
        finish(study)
        first, second = study.run.trajectory(0), study.run.trajectory(1)
        assert first.columns == ("t", "y", "driven_x")
        assert set(first.column("driven_x")) == {x + 0.015}
        assert set(second.column("driven_x")) == {study.run.tests["x"][1]}, "without it: the one that was asked for"
        assert study.run.verify().checks.good
        statuses = {each.id: (each.status, each.detail) for each in study.run.certificate.assumptions}
        status, words = statuses["driven_starts/robustness"]
        assert status == "assumed"
        assert "(x within 0.02 m)" in words


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"x": 2.0}, "x = 2 was driven"),
        ({"x": float("nan")}, "start: x"),
        ({"x": "here"}, "start: x"),
        ({"y": 0.5}, "start: 'y' is none of x"),
        ([0.5], "start: list is no dict"),
    ],
)
def test_a_start_that_does_not_count_is_refused_and_the_request_stays_open(
    tmp_path: Path, given: Any, words: str
) -> None:
    with told(tmp_path) as study:
        request = study.ask()
        with pytest.raises(PerfboundError) as error:
            study.tell(request, curve(request), start=given)
        assert words in str(error.value)
        assert study.ask() == request


def test_a_start_needs_a_tolerance(tmp_path: Path) -> None:
    with told(tmp_path, rig()) as study, pytest.raises(PerfboundError, match="the rig has no tolerance"):
        study.tell(study.ask(), curve(study.ask()), start={"x": 0.5})


def test_a_tolerance_that_is_none_is_refused() -> None:
    with pytest.raises(DefinitionError, match="rig 'rig': tolerance: "):
        rig(tolerance=0.2)


def test_disturbances_that_were_measured_are_columns(tmp_path: Path) -> None:
    made = rig(columns={"y": "m", "wind": "m/s"}, reported={"wind": pb.Normal(0, 2)})
    with told(tmp_path, made) as study:
        while (request := study.ask()) is not None:
            study.tell(request, {"t": T, "y": 0.1 * T}, disturbances={"wind": 0.5})
        assert set(study.run.trajectory(3).column("wind")) == {0.5}
        with pytest.raises(PerfboundError, match="'gust' is none of wind"):
            study.tell("robustness.0.nominal.0", {"t": T, "y": 0.1 * T}, disturbances={"gust": 0.5})


def test_a_bound_of_a_kernel_counts_the_tolerance(tmp_path: Path) -> None:
    """What a function of norm B may change between two starts that are so near."""
    with pytest.raises(CampaignError) as error:
        pb.Campaign(TOLERANT, **LIMITED)
    needed = float(str(error.value).partition("give misspecification = ")[2].partition(",")[0])
    # Matern 5/2 at small distances: 2 - 2 k = 5/3 (r/l)^2.
    assert needed == pytest.approx(2.0 * np.sqrt(5 / 3) * 0.02 / 0.5, rel=0.02)
    without = pb.Campaign(rig(), **LIMITED).ask_tell(tmp_path / "without")
    counted = pb.Campaign(TOLERANT, **LIMITED, misspecification=needed).ask_tell(tmp_path / "run")
    with without, counted:
        finish(without)
        finish(counted)
    found = counted.run.certificate
    assert found.claims[0].bound < without.run.certificate.claims[0].bound
    status = {each.id: each.status for each in found.assumptions}
    assert status["driven_starts/robustness"] == "derived"


@pytest.mark.parametrize(
    ("method", "without", "added"),
    [("kriging", ("alpha", "resolution", "noise_scale"), {}), ("paper", (), {"c": 2.0})],
)
def test_a_method_that_does_not_count_it_is_refused(
    method: str, without: tuple[str, ...], added: dict[str, Any]
) -> None:
    keys = {key: value for key, value in LIMITED.items() if key not in without}
    with pytest.raises(CampaignError, match="of a rig with a tolerance choose 'sample' or"):
        pb.Campaign(TOLERANT, **keys, **added, method=method)

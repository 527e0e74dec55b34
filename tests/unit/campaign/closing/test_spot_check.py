"""What the fresh starts of the spot check show of gaps and of the clip."""

import json
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.verdict import UNDER_REFUTED
from perfbound.orchestrator.certificate.words import text
from perfbound.orchestrator.run.known import verdict_of
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import noise, predicate, robustness, simulate, spec, statuses, verified

KERNEL = {"alpha": 0.02, "rkhs_norm": 0.2, "kernel": {"length_scale": 1.0}}
PAIR = [
    {"name": "nominal_robustness", "method": "rigorous", "noise_scale": 0.0, "prior_mean": -0.5, **KERNEL},
    {"name": "sim_gap", "method": "rigorous", "noise_scale": 0.0, "prior_mean": 0.4, **KERNEL},
]
DOMINATED = "lipschitz/sim_gap"


def composed(**changes: Any) -> CampaignConfig:
    """Return a campaign of two variants, whose specification is steep where no test of its problems is."""
    box = {"low": 0.0, "high": 1.0, "unit": "1"}
    found = {
        "name": "composed",
        "seed": 1,
        "horizon": 1.0,
        "composition": "bhatia-davis",
        "specification": "always (0.5 >= value^8)",
        "clip": [-1, 1],
        "risk_weight": 0.2,
        "gap": {"kind": "signal_sup", "column": "value", "lipschitz": 0.1},
        "system": {"name": "any-function"},
        "space": {"z1": box, "z2": box},
        "resolution": 6,
        "max_tests": 6,
        "visual": "none",
        "problems": PAIR,
    }
    return CampaignConfig.model_validate_json(json.dumps(found | changes))


def narrow(request: RolloutRequest) -> float:
    """The true system is near the limit in a strip of 6 % of the box, between the nodes of the lattice."""
    if request.variant == "nominal":
        return 0.6
    return 0.892 if 0.42 < request.x[0] < 0.48 else 0.15


def noisy_narrow(request: RolloutRequest) -> float:
    return narrow(request) + (0.001 * noise(request.seed) if request.variant == "true" else 0.0)


@pytest.mark.rest
@pytest.mark.parametrize("noisy", [False, True])
def test_a_gap_that_does_not_dominate_at_a_fresh_start_refutes_the_composed_claim(
    tmp_path: Path, *, noisy: bool
) -> None:
    """Each bound keeps at every start, and their composition is false where L is too small."""
    system = spec(noisy=False).model_copy(update={"variants": ("nominal", "true"), "noisy": ("true",) if noisy else ()})
    noise_scale = [
        {**problem, "noise_scale": 0.01} if noisy and problem["name"] == "sim_gap" else problem for problem in PAIR
    ]
    config = composed(problems=noise_scale)
    found = simulate(tmp_path, config, noisy_narrow if noisy else narrow, noisy=noisy, system=system)
    claim = predicate(found)["claims"][0]
    assert claim["bound"] > 0.1, "the robustness in the strip is .1"
    assert statuses(found)[DOMINATED] == "refuted"
    assert DOMINATED in claim["refuted"]
    assert {each["status"] for each in predicate(found)["spot_check"]["problems"]} == {"not refuted"}
    assert not verified(tmp_path)
    certificate = files.read(tmp_path)
    assert certificate is not None
    assert verdict_of(tmp_path, stored_header(tmp_path), certificate).verdict == "NOT SHOWN"


@pytest.mark.rest
def test_a_gap_that_dominates_is_not_refuted(tmp_path: Path) -> None:
    system = spec(noisy=False).model_copy(update={"variants": ("nominal", "true")})
    config = composed(gap={"kind": "signal_sup", "column": "value", "lipschitz": 8.0})
    assert statuses(simulate(tmp_path, config, narrow, noisy=False, system=system))[DOMINATED] == "assumed"


RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 0.5, "prior_mean": -0.3, "kernel": {"length_scale": 0.7}}


def rare_fall(request: RolloutRequest) -> float:
    """A fall in a strip of the box that no node of the lattice is in."""
    return -1000.0 if 0.43 < request.x[0] < 0.47 else 0.3 + 0.05 * noise(request.seed)


@pytest.mark.rest
def test_values_that_the_clip_hides_at_fresh_starts_are_said_beside_the_claim(tmp_path: Path) -> None:
    config = robustness(
        {**RIGOROUS, "noise_scale": 0.6, "replicates": 4}, clip=[-0.2, 1.0], max_tests=8, spot_check_followups=0
    )
    found = predicate(simulate(tmp_path, config, rare_fall, noisy=True))
    (clip,) = (each for each in found["assumptions"] if each["id"] == "clip/robustness")
    assert clip["values"]["at_low"] > 0
    assert clip["values"]["values"] == 8 * 4 + found["spot_check"]["rollouts"]["nominal"]
    certificate = files.read(tmp_path)
    assert certificate is not None
    assert any(says(note, "claim clipped robustness:") for note in text.notes(certificate.predicate, 0))


def test_a_clip_many_times_the_noise_hides_no_fresh_start(tmp_path: Path) -> None:
    """No bet within the range of the clip shows it: the noise scale that the claim rests on does."""

    def lower(request: RolloutRequest) -> float:
        return (0.1 if 0.43 < request.x[0] < 0.57 and request.x[0] != 0.5 else 0.5) + 0.02 * noise(request.seed)

    little = {**RIGOROUS, "noise_scale": 0.05, "rkhs_norm": 0.05, "prior_mean": -0.5}
    config = robustness(little, clip=[-100.0, 100.0], max_tests=8, spot_check=60, spot_check_followups=60)
    found = predicate(simulate(tmp_path, config, lower, noisy=True))
    (checked,) = found["spot_check"]["problems"]
    assert found["claims"][0]["bound"] > 0.1
    assert checked["status"] == "refuted"
    assert checked["start"] is not None


@pytest.mark.rest
def test_of_most_starts_nothing_is_claimed_that_the_clip_alone_proves(tmp_path: Path) -> None:
    """On a fifth of the box the robustness is far below the clip."""

    def cliff(request: RolloutRequest) -> float:
        return -1000.0 if request.x[0] > 0.8 else 0.5

    config = robustness({**RIGOROUS, "noise_scale": 0.0}, clip=[-0.2, 1.0], max_tests=8)
    assert predicate(simulate(tmp_path, config, cliff, noisy=False))["spot_check"]["most_starts"] is None


@pytest.mark.rest
@pytest.mark.parametrize("noisy", [False, True])
def test_what_is_claimed_of_means_at_most_starts_names_the_clip(tmp_path: Path, *, noisy: bool) -> None:
    """A value above the lower clip is the value itself; a mean of such values is not."""
    config = robustness({**RIGOROUS, "noise_scale": 0.1 if noisy else 0.0}, clip=[-0.2, 1.0], max_tests=8)
    assert simulate(tmp_path, config, lambda _: 0.5, noisy=noisy)
    certificate = files.read(tmp_path)
    assert certificate is not None
    (note,) = (each for each in text.notes(certificate.predicate, 0) if each.startswith("Without a kernel: "))
    words = "the expected robustness, clipped to [-0.2, 1], is" if noisy else "the robustness is"
    assert f"{words} at least 0." in note


def dip(request: RolloutRequest) -> float:
    """A rollout violates the specification in a strip of 4 % of the box, without one of four listed starts."""
    return -0.2 if 0.6 < request.x[0] < 0.64 else 0.5


@pytest.mark.parametrize("method", ["rigorous", "scenario"])
def test_violations_between_listed_starts_refute_nothing_and_are_said(tmp_path: Path, method: str) -> None:
    problem = {"method": "scenario", "alpha": 0.1} if method == "scenario" else {**PAIR[0], "name": "robustness"}
    config = robustness(problem, candidates=4, where="z2 <= 0.9", clip=(-1.0, 1.0), max_tests=40, spot_check=100)
    found = simulate(tmp_path, config, dip, noisy=False)
    claim, checked = predicate(found)["claims"][0], predicate(found)["spot_check"]
    assert (claim["starts"], claim["refuted"], claim["bound"] > 0) == (4, [], True)
    (problem,) = checked["problems"]
    assert (problem["status"], problem["violations"]) == ("beyond", checked["failures"])
    assert problem["violations"] > 0
    assert problem["start"][1] <= 0.9, "of the region alone"
    assert 0.6 < problem["start"][0] < 0.64
    assert not verified(tmp_path)
    certificate = files.read(tmp_path)
    assert certificate is not None
    verdict = verdict_of(tmp_path, stored_header(tmp_path), certificate)
    assert verdict.verdict == "VIOLATED", "a rollout of the system fails, wherever it starts"
    assert says(" ".join(verdict.reasons), "fresh start none of the 4 listed")
    assert not verdict.claim.startswith(UNDER_REFUTED)

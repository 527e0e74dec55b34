"""What a claim owes to its constants: computed again with others, without rollouts, and by the clip alone."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import Matern

from perfbound.orchestrator.campaign.methods import kernel_method
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.sensitivity import VARIATIONS
from perfbound.orchestrator.certificate.verify.checks import Checks
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.certificate.words.text import notes
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.problem_models import RigorousProblem
from perfbound.schemas.result.certificate import CampaignId, Certificate, CertificateClaim, Evidence, Predicate
from tests.campaigns import table
from tests.facts import says
from tests.fakes.finished import a_list, a_pair, finish, play

FIXTURES = Path(__file__).parents[2] / "fixtures"


def a_problem(**problem: Any) -> CampaignConfig:
    """Return the test function, whose puppets answer with values about .05, with changes of its problem."""
    found = table("test-function-rigorous", resolution=7)
    found["problems"][0] |= {"max_tests": 8, "window": 1, "alpha": 1e-9, "rkhs_norm": 0.3, **problem}
    return CampaignConfig.model_validate_json(json.dumps(found))


def finished(directory: Path, campaign: CampaignConfig) -> Certificate:
    stage = play(directory, campaign)
    finish(stage, directory)
    found = files.read(directory)
    assert found is not None
    return found


def check(directory: Path) -> Checks:
    return verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair whose claims are more than the clip and the constants prove."""
    directory = tmp_path_factory.mktemp("pair") / "run"
    found = table("segway-pair", horizon=1.0, resolution=7)
    for problem in found["problems"]:
        problem |= {"max_tests": 4, "alpha": 1e-9, "replicates": min(problem["replicates"], 8)}
    finished(directory, CampaignConfig.model_validate_json(json.dumps(found)))
    return directory


@pytest.fixture(scope="module")
def predicate(original: Path) -> Predicate:
    found = files.read(original)
    assert found is not None
    return found.predicate


@pytest.mark.rest
def test_every_claim_has_every_variation(predicate: Predicate) -> None:
    rows = predicate.sensitivity or ()
    wanted = [(k, *each) for k in range(len(predicate.claims)) for each in VARIATIONS]
    assert [(row.claim, row.constant, row.factor) for row in rows] == wanted
    assert len(predicate.claims) == 3, "pointwise, Bhatia-Davis, sum"


def test_a_larger_norm_proves_less(predicate: Predicate) -> None:
    for k, claim in enumerate(predicate.claims):
        bounds = {(row.constant, row.factor): row.bound for row in predicate.sensitivity or () if row.claim == k}
        twice, four = bounds["rkhs_norm", 2.0], bounds["rkhs_norm", 4.0]
        assert twice is not None
        assert four is not None
        assert four < twice < claim.bound


def test_the_bound_of_method_paper_is_that_of_its_last_test(tmp_path: Path) -> None:
    """Against Algorithm 1 written down with a dense kernel matrix."""
    stage = play(tmp_path / "run", a_problem(method="paper", c=0.05, noise_scale=0.01))
    account = stage.ledger.accounts["maximum"]
    tests = account.closed
    finish(stage, tmp_path / "run")
    found = files.read(tmp_path / "run")
    assert found is not None
    rows = found.predicate.sensitivity
    assert rows is not None
    for row, (norm, length) in zip(rows, [(0.6, 1.0), (1.2, 1.0), (0.3, 0.5)], strict=True):
        n, kernel = len(tests) - 1, Matern(length_scale=length, nu=10.0)
        x = np.array([proposal.x for proposal, _ in tests])
        within, to_last = kernel(x[:n]) + (1 + 2 / n) * np.eye(n), kernel(x[:n], x[n:])[:, 0]
        beta = norm + 0.01 * math.sqrt(np.linalg.slogdet(within)[1] + 2 * math.log(1 / 0.05))
        distance = 2 * beta * (1.0 - to_last @ np.linalg.solve(within, to_last))
        assert row.bound == pytest.approx(tests[-1][1].y + max(1e-9, distance) + 0.05, abs=1e-8)


def test_the_bound_of_method_rigorous_follows_from_all_tests_at_once(tmp_path: Path) -> None:
    stage = play(tmp_path / "run", a_problem(noise_scale=0.03))
    account = stage.ledger.accounts["maximum"]
    finish(stage, tmp_path / "run")
    found = files.read(tmp_path / "run")
    assert found is not None
    rows = found.predicate.sensitivity
    assert rows is not None
    assert isinstance(account.plan.problem, RigorousProblem)
    for row, factor in zip(rows, (2.0, 4.0), strict=False):
        problem = account.plan.problem.model_copy(update={"rkhs_norm": factor * 0.3})
        one_by_one = kernel_method(replace(account.plan, problem=problem))
        bounds = [one_by_one.observe(*test).upper for test in account.closed]
        assert row.bound is not None
        assert min(bound for bound in bounds if bound is not None) <= row.bound <= factor * 0.3
        assert row.bound == pytest.approx(bounds[-1], abs=0.02), "the running bounds gain little"


def test_a_constant_that_the_data_refute_gives_no_bound(tmp_path: Path) -> None:
    """The puppets' values, about .05 at every start, are no function of so short a length scale and so small a norm."""
    found = finished(tmp_path / "run", a_problem(noise_scale=0.0, round_off=1e-3, rkhs_norm=0.02)).predicate
    assert [claim.refuted for claim in found.claims] != [()]
    rows = {(row.constant, row.factor): row.bound for row in found.sensitivity or ()}
    assert rows["length_scale", 0.5] is None
    assert "with half the length scale no bound" in notes(found, 0)[-1]


def test_the_assumptions_alone(predicate: Predicate) -> None:
    """m0 and B give a robustness >= .73 - .15 and a gap <= .04 + .2; the rest is arithmetic, see section 3 of [PB]."""
    assert {each.name: each.by_clip for each in predicate.problems} == {"nominal_robustness": -0.05, "sim_gap": 0.8}
    mean, low, high, weight = 0.58 - 0.24, -0.05, 0.75, 0.2
    davis = mean - weight * math.sqrt((high - mean) * (mean - low))
    wanted = {"pointwise": davis, "bhatia-davis": davis, "sum": mean - weight * (high - low) / 2}
    for claim in predicate.claims:
        assert claim.by_clip == pytest.approx(0.35 - 0.4 * math.sqrt(1.04), abs=2e-9)
        assert claim.without_data == pytest.approx(wanted[claim.rule], abs=2e-9)
        assert claim.without_data is not None
        assert claim.without_data <= claim.bound
        assert claim.vacuous is False


def test_the_rollouts_raise_what_the_constants_prove(tmp_path: Path) -> None:
    """m0 = .05 and B = .1 give J* <= .15 without a rollout."""
    kernel = {"nu": 2.5, "length_scale": 20.0}
    smooth = a_problem(noise_scale=0.01, prior_mean=0.05, rkhs_norm=0.1, kernel=kernel)
    found = finished(tmp_path / "run", smooth).predicate
    (claim,) = found.claims
    assert (claim.without_data, claim.by_clip, claim.vacuous) == (0.15, None, None)
    assert claim.bound < 0.15
    assert says(notes(found, 0)[0], "^Without any rollout B mean 0.1500 rollouts lower")


def test_a_claim_without_a_kernel_has_no_constants(tmp_path: Path) -> None:
    found = finished(tmp_path / "run", a_list())
    (claim,) = found.predicate.claims
    assert (found.predicate.sensitivity, claim.without_data) == (None, None)
    assert claim.vacuous is not None
    assert "sensitivity" not in json.loads(found.to_json())["predicate"]
    assert notes(found.predicate, 0) == ()


def test_a_composition_below_the_clip_is_raised_to_it_and_called_vacuous(tmp_path: Path) -> None:
    found = finished(tmp_path / "run", a_pair("paper")).predicate
    assert found.composition is not None
    assert found.composition.bound < found.claims[0].bound == found.claims[0].by_clip
    assert all(claim.vacuous for claim in found.claims)
    assert check(tmp_path / "run").good


EDITS: dict[str, tuple[Callable[[Any], object], str]] = {
    "a variation is better": (lambda p: p["sensitivity"][0].update(bound=0.04), "claims"),
    "a variation has no bound": (lambda p: p["sensitivity"][1].update(bound=None), "claims"),
    "a variation of another constant": (lambda p: p["sensitivity"][0].update(factor=1.0), "claims"),
    "a variation is gone": (lambda p: p["sensitivity"].pop(), "claims"),
    "all variations are gone": (lambda p: p.pop("sensitivity"), "claims"),
    "no variation at all": (lambda p: p.update(sensitivity=[]), "claims"),
    "less without data": (lambda p: p["claims"][0].update(without_data=-0.0579), "claims"),
    "nothing without data": (lambda p: p["claims"][1].pop("without_data"), "claims"),
    "vacuous or not": (lambda p: p["claims"][0].update(vacuous=not p["claims"][0]["vacuous"]), "claims"),
    "no word of it": (lambda p: p["claims"][0].pop("vacuous"), "claims"),
    "a lower clip": (lambda p: p["claims"][2].update(by_clip=-0.06), "claims"),
    "a lower clip of a problem": (lambda p: p["problems"][0].update(by_clip=-0.06), "problems"),
}


@pytest.mark.rest
@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_of_it_fails(edit: str, original: Path, tmp_path: Path) -> None:
    directory = Path(shutil.copytree(original, tmp_path / "run"))
    assert check(directory).good
    change, line = EDITS[edit]
    value = json.loads((directory / files.CERTIFICATE).read_text())
    change(value["predicate"])
    (directory / files.CERTIFICATE).write_text(Certificate.model_validate_json(json.dumps(value)).to_json())
    assert [found.name for found in check(directory).lines() if found.status == "failed"] == [line]


def a_claim(**values: Any) -> Predicate:
    claim = CertificateClaim(
        quantity="rho_star", sense=">=", bound=0.5, probability=0.95, rule="single", method="rigorous",
        assumptions=(), refuted=(), by_clip=-0.06, vacuous=False, without_data=0.46,
    ).model_copy(update=values)  # fmt: skip
    return Predicate(
        question={}, campaign=CampaignId(name="c", seed=1, config_sha256="", system_sha256=""), claims=(claim,),
        problems=(), composition=None, assumptions=(), software={}, rules=1,
        evidence=Evidence(manifest_sha256="", chain_head="", rollouts=0),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({}, "^Without any rollout B mean 0.4600 rollouts raise 0.5000"),
        ({"without_data": -0.06}, "^Without any rollout clip -0.0600 rollouts raise 0.5000"),
        ({"bound": 0.46}, "^Without any rollout B mean 0.4600: rollouts nothing"),
        ({"bound": 0.4}, "^Without any rollout B mean 0.4600 stronger B mean wrong method"),
    ],
)  # fmt: skip
def test_the_sentence_of_the_share_of_the_rollouts(values: dict[str, float], sentence: str) -> None:
    (found,) = notes(a_claim(**values), 0)
    assert says(found, sentence)


@pytest.mark.parametrize("kind", ["paper", "rigorous"])
def test_a_length_scale_per_parameter_is_certified_and_verified(kind: str, tmp_path: Path) -> None:
    lengths = {"z2": 40.0, "z1": 2.0}
    extra = {"method": "paper", "c": 0.05} if kind == "paper" else {"method": "rigorous"}
    found = finished(
        tmp_path / "run", a_problem(**extra, noise_scale=0.01, kernel={"nu": 2.5, "length_scale": lengths})
    ).predicate
    assert check(tmp_path / "run").good
    parameters = found.problems[0].parameters["kernel"]
    assert parameters == {"nu": 2.5, "length_scale": lengths}
    halved = next(row.bound for row in found.sensitivity or () if row.constant == "length_scale")
    assert halved is not None
    if kind == "rigorous":
        (ball,) = (each for each in found.assumptions if each.id == "kernel/maximum")
        assert ball.values is not None
        assert ball.values["length_scale"] == "2 (z1), 40 (z2)"
        assert "length scale 2 (z1), 40 (z2)" in ball.detail
        assert halved >= found.claims[0].bound

"""The risk at a start where a bound of it is refuted: decided by fresh rollouts, and in no campaign without one."""

import hashlib
import json
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.campaign.closing.risk_check import RiskCheck
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.bound_text import outward
from perfbound.orchestrator.certificate.words.text import check_sentences
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import export, read
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Predicate, SpotCheck, SpotCheckedProblem
from perfbound.schemas.result.facts import RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import SystemSpec
from tests.facts import says
from tests.fakes.simulators import noise, predicate, robustness, simulate, spec, verified

CLIP = (-0.05, 0.75)
RISK: dict[str, Any] = {
    "name": "true_risk",
    "method": "rigorous",
    "alpha": 1e-3,
    "rkhs_norm": 0.2,
    "prior_mean": -0.6,
    "noise_scale": 0.2,
    "kernel": {"nu": 2.5, "length_scale": 1.0},
    "linearised": {"centre": 0.7, "spread": 0.05},
}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def system(*, seed_bits: int = 53) -> SystemSpec:
    return spec(noisy=True).model_copy(update={"variants": ("true",), "noisy": ("true",), "seed_bits": seed_bits})


def a_campaign(**changes: Any) -> CampaignConfig:
    found: dict[str, Any] = {"clip": CLIP, "risk_weight": 1.0, "horizon": 1.0, "max_tests": 6, "window": 2}
    return robustness(RISK, **found | {"spot_check": 8, "spot_check_followups": 300, "recheck": 3} | changes)


def test_without_noise_a_refuted_norm_does_not_say_that_the_bound_is_false(tmp_path: Path) -> None:
    """The values are better than the constants suppose where no test is: the risk there is higher, and X is lower."""
    exact = system().model_copy(update={"noisy": ()})
    problem = {**RISK, "noise_scale": 0.0, "rkhs_norm": 0.05, "prior_mean": -0.63, "linearised": CENTRED}
    config = a_campaign(problems=[problem], clip=(-1.0, 1.5), spot_check=40)
    found = predicate(simulate(tmp_path, config, better_between, noisy=False, system=exact))
    (refuted,) = (each for each in found["assumptions"] if each["id"] == "rkhs_norm/true_risk")
    assert refuted["status"] == "refuted"
    assert says(refuted["detail"], "claim risk bound")
    assert "false" not in refuted["detail"]
    spot = SpotCheck.model_validate_json(json.dumps(found["spot_check"]))
    sentences = check_sentences(with_check(spot))
    assert says(sentences[1], "fresh starts bounds risk beyond")
    (check,) = found["spot_check"]["problems"]
    assert check["violations"] > 1
    assert check["status"] == "refuted"
    words = check_sentences(with_check(spot.model_copy(update={"failures": 1})))
    assert any(says(each, "1 40 rollouts fresh starts violates") for each in words)


def with_check(spot: SpotCheck) -> Predicate:
    claim: Any = SimpleNamespace(clipped=None)
    content: dict[str, Any] = {"claims": (claim,), "spot_check": spot, "recheck": None}
    return Predicate.model_construct(**content)


CENTRED = {"centre": 0.7, "spread": 0.1}


def better_between(request: RolloutRequest) -> float:
    unseen = not request.rollout.startswith("true_risk.") and request.x[0] > 0.5
    return 1.4 if unseen else 0.7


def with_hole(mean: float) -> Callable[[RolloutRequest], float]:
    """Return values with a risk of .68, and of `mean` - .02 in a third of the box, which no test of the bound sees."""

    def value(request: RolloutRequest) -> float:
        unseen = request.x[0] > 0.6 and not request.rollout.startswith(("true_risk.", "robustness."))
        return float(np.clip((mean if unseen else 0.7) + 0.02 * noise(request.seed), *CLIP))

    return value


DEEP = with_hole(0.1)
"""The bound of some .4 is false of the risk as well."""
ODD = with_hole(0.5)
"""The bound is false of E[X], which is .07 in the hole, and true of the risk, which is .48."""


def run(directory: Path, function: Any, config: CampaignConfig | None = None, **also: Any) -> Predicate:
    simulate(directory, config or a_campaign(), function, noisy=True, **{"system": system(), **also})
    found = files.read(directory)
    assert found is not None
    return found.predicate


def checked(found: Predicate) -> SpotCheckedProblem:
    assert found.spot_check is not None
    (problem,) = found.spot_check.problems
    return problem


def edited(directory: Path, change: Callable[[dict[str, Any]], object]) -> list[str]:
    """Return the checks that fail after a change of the record in the certificate."""
    place = directory / files.CERTIFICATE
    text = place.read_text()
    document = json.loads(text)
    change(document["predicate"]["spot_check"]["problems"][0])
    place.write_text(json.dumps(document, sort_keys=True, indent=1) + "\n")
    failed = verified(directory)
    place.write_text(text)
    return failed


def with_risk(change: dict[str, Any], problem: dict[str, Any]) -> None:
    problem["risk"].update(change)


def rollouts_of(directory: Path) -> dict[str, list[RolloutFact]]:
    found: dict[str, list[RolloutFact]] = {}
    with read.reading(directory) as connection:
        for fact in recorded_facts.read_facts(connection):
            if isinstance(fact, RolloutFact):
                found.setdefault(fact.rollout.problem, []).append(fact)
    return found


def test_a_risk_below_the_bound_is_said_with_every_rollout(tmp_path: Path) -> None:
    found = run(tmp_path, DEEP)
    problem, (claim,) = checked(found), found.claims
    assert (problem.status, claim.refuted) == ("refuted", ("rkhs_norm/true_risk",))
    risk = problem.risk
    assert risk is not None
    assert risk.status == "below"
    assert 0.08 < risk.risk < problem.limit == claim.bound
    assert risk.risk == pytest.approx(risk.mean - risk.deviation, abs=2e-9)
    assert 5 < risk.rollouts <= 20
    with closing(Journal.open(tmp_path)) as journal:
        ledger = Ledger(tmp_path, journal)
        ledger.replay()
        series = ledger.series["risk_check"]
        named = {ledger.closing.spot_check.starts[node] for node in series.nodes} if ledger.closing.spot_check else ()
    assert named == {problem.start}
    header, rows = export.table_rows(tmp_path, "tests")
    observation = [column.name for column in header].index("observation")
    exported = [row[observation] for row in rows if row[0] == "risk_check" and row[observation] is not None]
    assert exported == pytest.approx([0.1] * risk.rollouts, abs=0.1)
    assert len(series.observations) == risk.rollouts
    assert found.spot_check is not None
    assert found.spot_check.rollouts.true == problem.rollouts
    below = f"below the bound {outward(problem.limit, '>=')}, by {risk.rollouts} further rollouts: the claim is false"
    assert below in " ".join(check_sentences(found))
    assert not verified(tmp_path)


@pytest.mark.rest
def test_a_risk_that_keeps_the_bound_is_not_said_to_be_below(tmp_path: Path) -> None:
    found = run(tmp_path, ODD)
    problem = checked(found)
    assert problem.status == "refuted"
    assert problem.risk is not None
    assert problem.risk.status == "not decided"
    assert problem.risk.rollouts == 308 - problem.rollouts > 0
    assert problem.limit < 0.48 < problem.risk.risk
    sentences = " ".join(check_sentences(found))
    assert says(sentences, "claim risk below")
    assert f"is not decided by {problem.risk.rollouts} further rollouts" in sentences
    assert not verified(tmp_path)


@pytest.mark.rest
def test_workers_and_stops_change_no_byte(tmp_path: Path) -> None:
    def stop(request: RolloutRequest) -> bool:
        return request.rollout.startswith("risk_check.4.")

    run(tmp_path / "one", DEEP, workers=1)
    run(tmp_path / "five", DEEP, workers=5)
    assert simulate(tmp_path / "cut", a_campaign(), DEEP, noisy=True, system=system(), stop=stop) is None
    run(tmp_path / "cut", DEEP)
    texts = {(tmp_path / name / files.CERTIFICATE).read_bytes() for name in ("one", "five", "cut")}
    assert len(texts) == 1


def test_without_a_refuted_risk_there_is_no_record(tmp_path: Path) -> None:
    assert checked(run(tmp_path / "kept", with_hole(0.7))).risk is None
    assert "risk_check" not in rollouts_of(tmp_path / "kept")
    (problem,) = json.loads((tmp_path / "kept" / files.CERTIFICATE).read_text())["predicate"]["spot_check"]["problems"]
    assert "risk" not in problem


def test_a_refuted_mean_needs_no_further_rollout(tmp_path: Path) -> None:
    mean = {key: value for key, value in RISK.items() if key != "linearised"} | {"name": "robustness"}
    found = checked(run(tmp_path, DEEP, a_campaign(problems=[mean])))
    assert found.status == "refuted"
    assert found.start is not None
    assert "risk_check" not in rollouts_of(tmp_path)


@pytest.mark.rest
def test_verify_finds_an_edited_record(tmp_path: Path) -> None:
    run(tmp_path, ODD)
    assert edited(tmp_path, lambda problem: None) == []
    for change in ({"status": "below"}, {"rollouts": 9}, {"mean": 0.3}, {"deviation": 0.4}, {"risk": 0.2}):
        assert "spot check" in edited(tmp_path, partial(with_risk, change)), change
    assert "spot check" in edited(tmp_path, lambda problem: problem.pop("risk"))


def test_seeds_of_few_bits_differ_from_all_others(tmp_path: Path) -> None:
    run(tmp_path, DEEP, system=system(seed_bits=31))
    found = rollouts_of(tmp_path)
    seeds = [fact.seed for name, facts in found.items() if name != "recheck" for fact in facts]
    assert len(found["risk_check"]) > 5
    assert len(set(seeds)) == len(seeds)
    assert not verified(tmp_path)


def test_without_tests_left_nothing_is_decided(tmp_path: Path) -> None:
    whole = checked(run(tmp_path / "whole", DEEP))
    budget = whole.rollouts - 8
    found = checked(run(tmp_path / "spent", DEEP, a_campaign(spot_check_followups=budget)))
    assert found.rollouts <= whole.rollouts
    assert found.risk is None


def test_each_refuted_requirement_has_its_own_rollouts(tmp_path: Path) -> None:
    requirements = [{"name": "whole", "formula": "value >= 0"}, {"name": "half", "formula": "value >= 0.1"}]
    config = a_campaign(specification=None, specifications=requirements, spot_check_followups=600)
    found = run(tmp_path, DEEP, config)
    assert found.spot_check is not None
    problems = {each.requirement: each for each in found.spot_check.problems}
    assert {each.status for each in problems.values()} == {"refuted"}
    risks = [each.risk for each in problems.values() if each.risk is not None]
    assert [each.status for each in risks] == ["below"] * 2
    shared = problems["whole"].start == problems["half"].start
    recorded = len({fact.rollout.test for fact in rollouts_of(tmp_path)["risk_check"]})
    assert recorded >= (max if shared else sum)(each.rollouts for each in risks)
    # The robustness of the second one is .1 lower.
    assert risks[1].mean < risks[0].mean
    assert sum("the claim is false" in each for each in check_sentences(found)) == 2
    assert not verified(tmp_path)


@pytest.mark.parametrize("recheck", [3, 0])
def test_verify_finds_a_check_that_was_removed(tmp_path: Path, recheck: int) -> None:
    run(tmp_path, DEEP, a_campaign(recheck=recheck))
    manifest, place = tmp_path / files.MANIFEST, tmp_path / files.CERTIFICATE
    left = "".join(line for line in manifest.read_text().splitlines(keepends=True) if "risk_check" not in line)
    manifest.write_text(left)
    document = json.loads(place.read_text())
    sha256 = hashlib.sha256(left.encode()).hexdigest()
    document["predicate"]["evidence"] |= {"manifest_sha256": sha256, "rollouts": len(left.splitlines())}
    document["subject"][0]["digest"]["sha256"] = sha256
    del document["predicate"]["spot_check"]["problems"][0]["risk"]
    place.write_text(json.dumps(document, sort_keys=True, indent=1) + "\n")
    assert verified(tmp_path) == ["stop"]


def test_the_last_test_that_the_spot_check_left_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    named = [SimpleNamespace(plan=SimpleNamespace(variants=("true",)))]
    monkeypatch.setattr("perfbound.orchestrator.campaign.closing.risk_check._refuted_risks", lambda _: named)
    spot: Any = SimpleNamespace(observer=None, starts=(), plan=SimpleNamespace(most_tests=5))
    header: Any = SimpleNamespace(config=SimpleNamespace(spot_replicates=1))
    found = RiskCheck.of(header, spot, 4)
    assert found is not None
    assert found.plan.max_tests == 1
    assert RiskCheck.of(header, spot, 5) is None

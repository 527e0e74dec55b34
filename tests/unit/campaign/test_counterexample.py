"""A campaign that ends with its first counterexample."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.orchestrator.campaign.counterexample import ended
from perfbound.orchestrator.campaign.plan import plan
from perfbound.orchestrator.campaign.series import Account
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.result.facts import RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.values import Bound, Verdict
from tests.fakes.simulators import noise, predicate, robustness, simulate, spec, verified

EXACT = {
    "method": "rigorous",
    "delta": 0.05,
    "alpha": 1e-3,
    "rkhs_norm": 4.0,
    "noise_scale": 0.0,
    "kernel": {"nu": 2.5, "length_scale": 1.0},
}
SCENARIO = {"method": "scenario", "delta": 0.05, "alpha": 1e-6, "replicates": 6}
LIST = {"scenarios": [[0.2, 0.2], [0.5, 0.8], [0.9, 0.4]]}
UNTIL = {"until_counterexample": True}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def sloped(request: RolloutRequest) -> float:
    """Return a value that is below 0 in the corner z1 > .9, z2 > .9 alone."""
    return 1.0 - max(request.x[0], 0.5) * max(request.x[1], 0.5) * 1.2


def shaky(request: RolloutRequest) -> float:
    return 0.5 - 0.4 * request.x[0] + 0.3 * noise(request.seed)


def recorded(directory: Path) -> list[RolloutFact]:
    """Return the rollouts of the problem."""
    with read.reading(directory) as connection:
        facts = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]
    return [fact for fact in facts if fact.rollout.problem == "robustness"]


def noisy_list(**changes: Any) -> CampaignConfig:
    return robustness(SCENARIO, **({"clip": [-1.0, 1.0], "space": LIST, "max_tests": 30} | changes))


def observed_tests(found: dict[str, Any]) -> int:
    return int(found["problems"][0]["tests"])


@pytest.mark.parametrize("window", [1, 4])
def test_the_first_test_below_zero_ends_the_campaign_for_any_number_of_workers(tmp_path: Path, window: int) -> None:
    texts = {
        simulate(
            tmp_path / str(workers), robustness(EXACT, window=window, **UNTIL), sloped, noisy=False, workers=workers
        )
        for workers in (1, 5)
    }
    assert len(texts) == 1
    found = predicate(texts.pop())
    assert 1 < observed_tests(found) < 40
    assert found["problems"][0]["stopped_by"] == "counterexample"
    counterexample = found["counterexample"]
    assert counterexample["test"] == observed_tests(found) - 1
    assert counterexample["robustness"] < 0
    assert set(counterexample["start"]) == {"z1", "z2"}
    assert "spot_check" not in found
    below = [each for each in recorded(tmp_path / "1") if (each.robustness or 0.0) < 0]
    assert [str(each.rollout) for each in below] == [counterexample["rollout"]]
    assert below[0].seed == counterexample["seed"]


def test_of_noisy_rollouts_the_worst_of_the_test_is_named(tmp_path: Path) -> None:
    found = predicate(simulate(tmp_path, noisy_list(**UNTIL), shaky, noisy=True))
    counterexample = found["counterexample"]
    assert counterexample["rollouts"] == 6
    name = RolloutId.parse(counterexample["rollout"])
    same = [each.robustness for each in recorded(tmp_path) if each.rollout.test == name.test]
    assert counterexample["robustness"] == min(value for value in same if value is not None)
    assert list(counterexample["start"].values()) in LIST["scenarios"]


@pytest.mark.rest
def test_without_one_the_campaign_is_the_usual_one(tmp_path: Path) -> None:
    safe = robustness(EXACT, max_tests=4), robustness(EXACT, max_tests=4, **UNTIL)
    usual, found = (
        predicate(simulate(tmp_path / str(number), config, lambda _: 0.5, noisy=False))
        for number, config in enumerate(safe)
    )
    assert "counterexample" not in found
    assert "until_counterexample" not in usual["question"]
    assert found["question"]["until_counterexample"] is True
    assert observed_tests(found) == observed_tests(usual)
    assert "spot_check" in found


def test_the_certificate_is_verified_and_says_it_first(tmp_path: Path) -> None:
    simulate(tmp_path, noisy_list(**UNTIL), shaky, noisy=True)
    assert verified(tmp_path) == []
    certificate = files.read(tmp_path)
    assert certificate is not None
    assert certificate.predicate.counterexample is not None
    shown = Console(width=300)
    with shown.capture() as text:
        print_certificate(certificate, shown)
    lines = [line for line in text.get().splitlines() if line]
    assert lines[0].startswith("COUNTEREXAMPLE  test ")
    assert "the worst of its 6 rollouts" in " ".join(" ".join(lines).split())
    assert any(line.startswith("CLAIM") for line in lines)
    page = Collector(tmp_path).refresh()
    assert page.counterexample is not None
    test = certificate.predicate.counterexample.test
    assert page.counterexample.sentences[0].startswith(f"Test {test} violates the spec")
    assert (page.counterexample.problem, page.counterexample.test) == ("robustness", test)
    (tmp_path / files.CERTIFICATE).unlink()
    before = Collector(tmp_path).refresh()
    assert before.counterexample == page.counterexample, "the live page shows it before there is a certificate"


def test_another_counterexample_is_not_verified(tmp_path: Path) -> None:
    simulate(tmp_path, noisy_list(**UNTIL), shaky, noisy=True)
    path = tmp_path / files.CERTIFICATE
    document = json.loads(path.read_text())
    document["predicate"]["counterexample"]["robustness"] -= 1.0
    path.write_text(Certificate.model_validate_json(json.dumps(document)).to_json())
    assert verified(tmp_path) != []


def test_it_is_found_again_after_a_stop(tmp_path: Path) -> None:
    calm = simulate(tmp_path / "calm", noisy_list(**UNTIL), shaky, noisy=True)
    last = predicate(calm)["counterexample"]["rollout"]
    config = noisy_list(**UNTIL)
    stopped = simulate(tmp_path / "run", config, shaky, noisy=True, stop=lambda each: each.rollout == last, workers=1)
    assert stopped is None
    assert simulate(tmp_path / "run", config, shaky, noisy=True) == calm


@pytest.mark.parametrize(
    ("verdict", "values", "expected"),
    [
        (None, (0.0, 0.3), None),
        (None, (0.1, -1e-9), "counterexample"),
        ("converged", (-0.1,), "counterexample"),
        ("refuted", (-0.1,), "refuted"),
        (None, (None,), None),
    ],
)
def test_one_rollout_below_zero_is_enough(
    verdict: Verdict | None, values: tuple[float | None, ...], expected: Verdict | None
) -> None:
    rollouts = [
        RolloutFact(RolloutId("robustness", 0, "nominal", number), 1, "0" * 64, 1, "p", value)
        for number, value in enumerate(values)
    ]
    config = robustness(EXACT)
    problem = plan(config, spec(noisy=False), config.problems[0])
    bound, account = Bound(1.0, 0.0, verdict), Account("", last_facts=rollouts, plan=problem)
    assert ended(robustness(EXACT, **UNTIL), bound, account) == Bound(1.0, 0.0, expected)
    assert ended(config, bound, account) == bound


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clip": [0.0, 1.0]}, "must begin below 0"),
        ({"problems": [EXACT | {"name": "maximum", "column": "value"}]}, "only for one problem"),
        (
            {
                "clip": [-1.0, 1.0],
                "problems": [EXACT | {"name": "robustness", "method": "paper", "c": 0.1, "noise_scale": 0.1}],
            },
            "method 'paper' has no bound",
        ),
    ],
)
def test_where_it_means_nothing_it_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        robustness(EXACT, **(UNTIL | changes))

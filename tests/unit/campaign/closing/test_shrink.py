"""The counterexample nearest to a nominal start: found by bisection, counted apart, and no part of a claim."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.robustness import read_values, read_violations
from perfbound.schemas import ids
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Certificate, Shrunk
from perfbound.schemas.result.facts import BoundFact, RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import noise, robustness, simulate, spec, verified

SAMPLE = {"method": "sample"}
SHRINK = {"shrink": True, "simplest_tests": 0}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def beyond(request: RolloutRequest) -> float:
    """Return a value below 0 farther than .3 from the middle."""
    return 0.3 - float(np.hypot(request.x[0] - 0.5, request.x[1] - 0.5))


def sought(falsify: dict[str, Any] = SHRINK, **changes: Any) -> CampaignConfig:
    return robustness(SAMPLE, **{"falsify": falsify, "clip": (-1.0, 1.0), "recheck": 3} | changes)


def shrunk(directory: Path) -> Shrunk | None:
    found = certificate(directory).predicate.counterexample
    assert found is not None
    return found.shrunk


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def distance(start: dict[str, float], to: tuple[float, float] = (0.5, 0.5)) -> float:
    return float(np.hypot(start["z1"] - to[0], start["z2"] - to[1]))


def test_the_nearest_failing_start_is_at_the_border(tmp_path: Path) -> None:
    simulate(tmp_path, sought(), beyond, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert found.nominal == {"z1": 0.5, "z2": 0.5}
    assert 0.3 < distance(found.start) < 0.302
    assert -0.002 < found.robustness < 0
    assert found.rollout.startswith("shrink.")
    assert 8 <= found.rollouts <= 20
    assert not verified(tmp_path)


def test_the_claims_are_those_without_it(tmp_path: Path) -> None:
    simulate(tmp_path / "with", sought(), beyond, noisy=False)
    simulate(tmp_path / "same", sought(), beyond, noisy=False, workers=4)
    one, other = certificate(tmp_path / "with"), certificate(tmp_path / "same")
    assert one.to_json() == other.to_json()
    assert one.predicate.problems[0].rollouts.nominal == one.predicate.problems[0].tests
    assert one.predicate.recheck is not None
    with read.reading(tmp_path / "with") as connection:
        facts = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]
    again = {fact.rollout.problem for fact in facts}
    assert again == {"robustness", "shrink", "recheck"}


def test_a_stop_in_between_changes_no_byte(tmp_path: Path) -> None:
    simulate(tmp_path / "calm", sought(), beyond, noisy=False)

    def stop(request: RolloutRequest) -> bool:
        return request.rollout.startswith("shrink.3")

    simulate(tmp_path / "cut", sought(), beyond, noisy=False, stop=stop)
    simulate(tmp_path / "cut", sought(), beyond, noisy=False)
    assert (tmp_path / "calm" / "certificate.json").read_bytes() == (tmp_path / "cut" / "certificate.json").read_bytes()


def test_it_goes_towards_the_start_that_is_given(tmp_path: Path) -> None:
    simulate(tmp_path, sought(SHRINK | {"nominal": {"z1": 0.4}}), beyond, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert found.nominal == {"z1": 0.4, "z2": 0.5}
    assert 0.3 < distance(found.start) < 0.302


def test_a_nominal_start_that_fails_is_the_answer(tmp_path: Path) -> None:
    simulate(tmp_path, sought(SHRINK | {"nominal": {"z1": 0.4}}), lambda _: -0.5, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert (found.start, found.rollouts) == ({"z1": 0.4, "z2": 0.5}, 1)


def test_the_budget_ends_it_with_the_nearest_so_far(tmp_path: Path) -> None:
    simulate(tmp_path, sought(SHRINK | {"shrink_tests": 3}), beyond, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert found.rollouts == 3
    assert found.robustness < 0
    with read.reading(tmp_path) as connection:
        bounds = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, BoundFact)]
    assert [fact.budget for fact in bounds if fact.problem == ids.SHRINK] == [False, False, True]


def test_every_rollout_of_a_noisy_system_has_the_seed_of_the_counterexample(tmp_path: Path) -> None:
    simulate(tmp_path, sought(), lambda each: beyond(each) + 0.05 * noise(each.seed), noisy=True)
    found = certificate(tmp_path).predicate.counterexample
    assert found is not None
    with read.reading(tmp_path) as connection:
        facts = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]
    shrunk_facts = [fact for fact in facts if fact.rollout.problem == "shrink"]
    assert {fact.seed for fact in shrunk_facts} == {found.seed}
    # Its one seed would count many times against a mean, and among the violations.
    used = [fact for fact in facts if fact.rollout.problem == "robustness"]
    values = sum(len(each.robustness) for each in read_values(tmp_path, "nominal", ["robustness"]))
    assert values == len(used) < len(used) + len(shrunk_facts)
    assert read_violations(tmp_path, "nominal").rollouts == len(used)
    assert not verified(tmp_path)


def test_in_a_list_it_takes_the_rows(tmp_path: Path) -> None:
    rows = [[x / 10, y / 10] for x in range(11) for y in range(11)]
    simulate(tmp_path, sought(space={"table": rows}), beyond, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert [found.start["z1"], found.start["z2"]] in rows
    assert distance(found.start) < 0.45


def test_the_region_is_not_left(tmp_path: Path) -> None:
    config = sought(SHRINK | {"nominal": {"z1": 0.0}}, where="z1 >= 0.2")
    # Every start fails, the nominal one too: the region alone ends the way to it.
    simulate(tmp_path, config, lambda _: -0.5, noisy=False)
    found = shrunk(tmp_path)
    assert found is not None
    assert 0.2 <= found.start["z1"] < 0.202


def test_without_a_counterexample_nothing_is_shrunk(tmp_path: Path) -> None:
    simulate(tmp_path, sought(max_tests=8), lambda _: 0.5, noisy=False)
    assert certificate(tmp_path).predicate.counterexample is None


def test_the_certificate_says_it_in_words(tmp_path: Path) -> None:
    simulate(tmp_path, sought(), beyond, noisy=False)
    console = Console(record=True, width=400)
    print_certificate(certificate(tmp_path), console)
    text = console.export_text()
    assert says(text, "seed start")
    assert "towards z1 = 0.5, z2 = 0.5: z1 = " in text


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValidationError, match="nominal: `shrink` and `simplest_tests` go there"):
        sought({"nominal": {"z1": 0.5}, "simplest_tests": 0})
    wrong = (({"z3": 0.5}, "unknown parameter; any-function has z1, z2"), ({"z1": 3.0}, "3 goes beyond"))
    for nominal, reason in wrong:
        with pytest.raises(CampaignError, match=reason):
            check(sought(SHRINK | {"nominal": nominal}), spec(noisy=False), "c.toml")


def test_a_search_without_it_keeps_its_identity() -> None:
    assert sought({}).digest == sought({"shrink": False, "shrink_tests": 20}).digest != sought().digest
    assert "shrink" not in sought({}).model_dump_json()

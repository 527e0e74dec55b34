"""The simplest failure after a search: found with the seed of the failure, counted apart, and no part of a claim."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from rich.console import Console
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.robustness import read_violations
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Certificate, Simplest
from perfbound.schemas.result.facts import RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import noise, robustness, simulate, verified


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)
    with threadpool_limits(1):
        yield


def by_one(request: RolloutRequest) -> float:
    """Return a value below 0 for large z1, whatever z2 is."""
    return 0.8 - request.x[0]


def by_either(request: RolloutRequest) -> float:
    """Return a value below 0 for large z1 or large z2, but not for both."""
    z1, z2 = request.x
    return 0.8 - max(z1, z2) + (1.0 if min(z1, z2) > 0.6 else 0.0)


def sought(falsify: dict[str, Any], **changes: Any) -> CampaignConfig:
    defaults = {"clip": (-1.0, 1.0), "recheck": 3, "spot_check": 0, "max_tests": 60}
    return robustness({"method": "sample"}, **defaults | changes, falsify=falsify)


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def simplest(directory: Path) -> Simplest | None:
    found = certificate(directory).predicate.counterexample
    assert found is not None
    return found.simplest


def rollouts(directory: Path) -> list[RolloutFact]:
    with read.reading(directory) as connection:
        return [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]


def test_what_does_not_matter_is_at_its_nominal_value_for_any_number_of_workers(tmp_path: Path) -> None:
    config = sought({"nominal": {"z2": 0.25}})
    whole = simulate(tmp_path / "one", config, by_one, noisy=False, workers=1)
    assert whole == simulate(tmp_path / "three", config, by_one, noisy=False, workers=3)
    found = simplest(tmp_path / "one")
    assert found is not None
    assert (found.away, found.nominal, found.start["z2"]) == (("z1",), {"z1": 0.5, "z2": 0.25}, 0.25)
    assert found.robustness == pytest.approx(0.8 - found.start["z1"])
    assert found.rollout.startswith("simplest.")
    assert found.rollouts == 3
    assert verified(tmp_path / "one") == []
    series = {fact.rollout.problem for fact in rollouts(tmp_path / "one")}
    assert series == {"robustness", "simplest", "recheck"}
    console = Console(record=True, width=400)
    print_certificate(certificate(tmp_path / "one"), console)
    assert says(console.export_text(), "only z1 away nominal robustness simplest. 3 rollouts")


def test_a_stop_in_between_changes_no_byte(tmp_path: Path) -> None:
    whole = simulate(tmp_path / "calm", sought({}), by_one, noisy=False)

    def stop(request: RolloutRequest) -> bool:
        return request.rollout.startswith("simplest.1")

    assert simulate(tmp_path / "cut", sought({}), by_one, noisy=False, stop=stop) is None
    assert simulate(tmp_path / "cut", sought({}), by_one, noisy=False) == whole


def test_each_cluster_has_its_own_with_its_own_seed(tmp_path: Path) -> None:
    config = sought({"until": "2 clusters"})
    simulate(tmp_path, config, lambda each: by_either(each) + 1e-3 * noise(each.seed), noisy=True)
    found = certificate(tmp_path).predicate.failures
    assert found is not None
    assert {each.simplest.away for each in found.clusters if each.simplest} == {("z1",), ("z2",)}
    facts = [fact for fact in rollouts(tmp_path) if fact.rollout.problem == "simplest"]
    tests = [each.simplest.rollouts for each in found.clusters if each.simplest]
    assert len(facts) == sum(tests)
    by_test = [fact.seed for fact in sorted(facts, key=lambda fact: fact.rollout.test)]
    assert by_test == [
        seed for each in found.clusters if each.simplest for seed in [each.seed] * each.simplest.rollouts
    ]
    # A seed that was chosen because it fails would count many times among the violations.
    assert read_violations(tmp_path, "nominal").rollouts == sum(
        fact.rollout.problem == "robustness" for fact in rollouts(tmp_path)
    )
    assert verified(tmp_path) == []


def test_a_failure_of_another_part_does_not_take_its_place(tmp_path: Path) -> None:
    def too_much_or_too_little(request: RolloutRequest) -> float:
        """Return a value below 0 for large z1 alone, and above 2 where z1 is at its nominal value."""
        return 3.0 if request.x[0] == 0.5 else 0.8 - request.x[0]

    config = sought({"nominal": {"z1": 0.5}}, specification="value <= 2 and value >= 0", clip=None)
    simulate(tmp_path, config, too_much_or_too_little, noisy=False)
    found = certificate(tmp_path).predicate.counterexample
    assert found is not None
    assert found.simplest is not None
    assert found.start["z1"] > 0.8
    assert found.simplest.away == ("z1",)
    assert verified(tmp_path) == []


@pytest.mark.parametrize(("most", "expected"), [(1, 1), (2, 2)])
def test_the_budget_of_a_failure_ends_it_with_the_simplest_so_far(tmp_path: Path, most: int, expected: int) -> None:
    simulate(tmp_path, sought({"simplest_tests": most}), by_one, noisy=False)
    found = simplest(tmp_path)
    assert found is not None
    assert found.rollouts == expected
    assert found.robustness < 0
    assert verified(tmp_path) == []


@pytest.mark.parametrize(
    ("falsify", "changes"),
    [
        ({"simplest_tests": 0}, {}),
        # A row of a table has no parameter that changes alone.
        ({}, {"space": {"table": [[0.9, 0.1], [0.1, 0.9], [0.95, 0.95]]}}),
    ],
)
def test_it_is_left_out_where_it_is_not_asked_for_or_not_possible(
    tmp_path: Path, falsify: dict[str, Any], changes: dict[str, Any]
) -> None:
    simulate(tmp_path, sought(falsify, **changes), by_one, noisy=False)
    assert simplest(tmp_path) is None


def test_the_region_is_not_left(tmp_path: Path) -> None:
    simulate(tmp_path, sought({}, where="z1 >= 0.7 or z2 <= 0.4"), lambda _: -0.5, noisy=False)
    found = simplest(tmp_path)
    assert found is not None
    assert len(found.away) == 1
    assert found.start["z1"] >= 0.7 or found.start["z2"] <= 0.4
    assert verified(tmp_path) == []


def test_a_nominal_start_that_fails_is_the_answer(tmp_path: Path) -> None:
    simulate(tmp_path, sought({}), lambda _: -0.5, noisy=False)
    found = simplest(tmp_path)
    assert found is not None
    assert (found.away, found.rollouts) == ((), 1)
    console = Console(record=True, width=400)
    print_certificate(certificate(tmp_path), console)
    assert says(console.export_text(), "every parameter nominal")


def test_a_search_over_disturbances_has_none_and_nominal_values_need_a_use() -> None:
    config = sought({"over": "disturbances", "simplest_tests": 7})
    assert config.falsify is not None
    assert config.falsify.simplifying_tests == 0
    with pytest.raises(ValidationError, match="nominal"):
        sought({"nominal": {"z1": 0.5}, "simplest_tests": 0})
    assert "simplest_tests" not in sought({}).model_dump_json()

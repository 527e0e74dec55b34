"""What the drawn tests of a search show of a search at random, and how close it came to a failure."""

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.search_text import failure_parts
from perfbound.orchestrator.certificate.words.text import print_counterexample
from perfbound.orchestrator.mathematics.bounds.one_law.failures import beta_mixture_lower, beta_mixture_upper
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import FailureCluster, Failures, Predicate, RandomTests
from perfbound.schemas.result.facts import RolloutFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import checks, robustness, simulate, verified

RIGOROUS = {
    "method": "rigorous",
    "alpha": 0.01,
    "rkhs_norm": 40.0,
    "noise_scale": 0.0,
    "kernel": {"length_scale": 0.5},
}


def sloped(request: RolloutRequest) -> float:
    """Return a value below 0 on the half of the square with large z1."""
    return 0.5 - request.x[0]


def sought(problem: dict[str, Any] | None = None, **changes: Any) -> CampaignConfig:
    defaults = {"clip": (-1.0, 1.0), "recheck": 3, "spot_check": 0, "max_tests": 24, "falsify": {}}
    return robustness(problem or {"method": "sample"}, **defaults | changes)


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


def printed(found: Predicate) -> str:
    console = Console(record=True, width=400)
    print_counterexample(found, console, "m")
    return console.export_text()


def recorded(directory: Path) -> list[RolloutFact]:
    with read.reading(directory) as connection:
        facts = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, RolloutFact)]
    return [fact for fact in facts if fact.rollout.problem == "robustness"]


def test_without_a_failure_it_says_what_drawn_tests_show_and_which_test_is_the_closest(tmp_path: Path) -> None:
    simulate(tmp_path, sought(), lambda each: 1.5 * (sloped(each) + 0.5) + 0.1, noisy=False)
    found = predicate(tmp_path).search
    assert found is not None
    assert found.at_random == RandomTests(
        tests=6, failures=0, share=(0.0, beta_mixture_upper(0, 6, 0.025)), probability=0.95
    )
    lowest = min(recorded(tmp_path), key=lambda fact: (fact.robustness, fact.rollout))
    assert found.closest is not None
    assert (found.closest.rollout, found.closest.robustness) == (str(lowest.rollout), lowest.robustness)
    assert found.closest.robustness == pytest.approx(1.5 * (1.0 - found.closest.start["z1"]) + 0.1)
    assert says(printed(predicate(tmp_path)), "SEARCH no test fails m z1 rollout None of 6 tests at random too few")
    sentences = " ".join(Collector(tmp_path).refresh().checks)
    assert says(sentences, "No test None of 6 tests")
    assert verified(tmp_path) == []


def test_the_tests_of_the_models_do_not_count(tmp_path: Path) -> None:
    simulate(tmp_path, sought(falsify={"until": "budget", "simplest_tests": 0}), sloped, noisy=False)
    facts = recorded(tmp_path)
    drawn = sum((fact.robustness or 0.0) < 0 for fact in facts if fact.rollout.test % 4 == 3)
    assert 0 < drawn < sum((fact.robustness or 0.0) < 0 for fact in facts)
    found = predicate(tmp_path).search
    assert found is not None
    assert found.closest is None
    share = beta_mixture_lower(drawn, 6, 0.025), beta_mixture_upper(drawn, 6, 0.025)
    assert found.at_random == RandomTests(tests=6, failures=drawn, share=share, probability=0.95)
    assert says(printed(predicate(tmp_path)), f"COUNTEREXAMPLE {drawn} of 6 tests at random")
    assert verified(tmp_path) == []


def test_where_no_start_is_drawn_nothing_is_said_of_random_ones(tmp_path: Path) -> None:
    simulate(tmp_path / "rigorous", sought(RIGOROUS, resolution=21, max_tests=8), lambda _: 0.4, noisy=False)
    found = predicate(tmp_path / "rigorous").search
    assert found is not None
    assert found.at_random is None
    assert found.closest is not None
    simulate(tmp_path / "sample", sought(falsify=None, max_tests=8), lambda _: 0.4, noisy=False)
    assert predicate(tmp_path / "sample").search is None
    assert "SEARCH" not in printed(predicate(tmp_path / "sample"))


def test_a_summary_shows_the_first_clusters() -> None:
    one = FailureCluster(
        violated=("always x < 1",), tests=2, starts={"x": (0, 1)}, start={"x": 1}, robustness=-1, rollout="r", seed=1
    )
    found = Failures(clusters=(one,) * 5, undecided=1)
    assert len(failure_parts(found, "")) == 6
    head, *shown, more = failure_parts(found, "", most=3)
    assert says(head, "5 clusters 11 failing tests 1 may")
    assert len(shown) == 3
    assert says(more, "certificate 2 further clusters")


def test_a_changed_number_does_not_verify(tmp_path: Path) -> None:
    simulate(tmp_path, sought(max_tests=8), lambda _: 0.4, noisy=False)
    text = (tmp_path / "certificate.json").read_text()
    assert text.count('"failures": 0') == 1
    (tmp_path / "certificate.json").write_text(text.replace('"failures": 0', '"failures": 1'))
    assert [each.name for each in checks(tmp_path) if each.status == "failed"]

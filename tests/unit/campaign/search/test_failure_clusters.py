"""A search that continues after its first failure, until it has found several kinds of failures, or to its budget."""

from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.certificate import Certificate, Failures
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import says
from tests.fakes.simulators import robustness, simulate, verified

SAMPLE = {"method": "sample"}
HOLES = (0.2, 0.3), (0.8, 0.75)


def in_holes(request: RolloutRequest) -> float:
    """Return a margin below 0 in two holes alone."""
    return min(4.0 * float(np.hypot(request.x[0] - x, request.x[1] - y)) for x, y in HOLES) - 0.3


def in_corners(request: RolloutRequest) -> float:
    """Return a value that is below 0 in one corner, and above 2 in the opposite one."""
    return 1.0 + 1.2 * (request.x[0] + request.x[1] - 1.0)


def sought(until: str, **changes: Any) -> CampaignConfig:
    falsify = {"until": until} | changes.pop("falsify", {})
    defaults = {"max_tests": 60, "clip": (-1.0, 1.0), "recheck": 3, "spot_check": 0, "window": 3}
    return robustness(SAMPLE, **defaults | changes, falsify=falsify)


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def failures(directory: Path) -> Failures:
    found = certificate(directory).predicate.failures
    assert found is not None
    return found


def hole(start: dict[str, float]) -> int:
    """Return which hole a start is in."""
    return int(np.argmin([np.hypot(start["z1"] - x, start["z2"] - y) for x, y in HOLES]))


def test_so_many_clusters_end_it_for_any_number_of_workers_and_the_certificate_verifies(tmp_path: Path) -> None:
    config = sought("2 clusters")
    assert not config.until_counterexample
    whole = simulate(tmp_path / "one", config, in_holes, noisy=False, workers=1)
    assert whole == simulate(tmp_path / "two", config, in_holes, noisy=False, workers=2)
    predicate, found = certificate(tmp_path / "one").predicate, failures(tmp_path / "one")
    assert predicate.problems[0].stopped_by == "counterexample"
    assert predicate.problems[0].tests < 60
    assert sorted(hole(each.start) for each in found.clusters) == [0, 1]
    assert [each.violated for each in found.clusters] == [(), ()]
    worst = min(found.clusters, key=lambda each: each.robustness)
    assert predicate.counterexample is not None
    assert (predicate.counterexample.rollout, predicate.counterexample.start) == (worst.rollout, worst.start)
    assert verified(tmp_path / "one") == []
    console = Console(width=300, record=True, file=StringIO())
    print_certificate(certificate(tmp_path / "one"), console)
    assert says(console.export_text().lower(), "2 clusters of failing starts cluster 1 cluster 2 robustness")
    report = Collector(tmp_path / "one").refresh()
    assert report.counterexample is not None
    assert says(" ".join(report.counterexample.sentences), "2 clusters of failing starts")


def test_the_budget_ends_a_search_that_finds_fewer_and_a_stop_changes_no_byte(tmp_path: Path) -> None:
    config = sought("3 clusters", max_tests=40)
    whole = simulate(tmp_path / "calm", config, in_holes, noisy=False)
    assert simulate(tmp_path / "cut", config, in_holes, noisy=False, stop=lambda request: request.test > 25) is None
    assert simulate(tmp_path / "cut", config, in_holes, noisy=False) == whole
    problem = certificate(tmp_path / "calm").predicate.problems[0]
    assert (problem.stopped_by, problem.tests) == ("budget", 40)
    assert {hole(each.start) for each in failures(tmp_path / "calm").clusters} == {0, 1}
    assert verified(tmp_path / "cut") == []


def test_a_map_spends_all_tests_and_what_is_violated_is_told_apart(tmp_path: Path) -> None:
    config = sought("budget", specification="value >= 0 and value <= 2", max_tests=30, clip=None)
    simulate(tmp_path, config, in_corners, noisy=False)
    predicate, found = certificate(tmp_path).predicate, failures(tmp_path)
    assert predicate.problems[0].tests == 30
    assert {each.violated for each in found.clusters} == {("value >= 0",), ("value <= 2",)}
    for each in found.clusters:
        assert all(low <= each.start[name] <= high for name, (low, high) in each.starts.items())
    assert predicate.counterexample is not None
    assert verified(tmp_path) == []


def test_without_a_failure_nothing_is_listed(tmp_path: Path) -> None:
    simulate(tmp_path, sought("budget", max_tests=12), lambda _: 0.5, noisy=False)
    assert certificate(tmp_path).predicate.failures is None
    assert certificate(tmp_path).predicate.counterexample is None
    assert verified(tmp_path) == []


@pytest.mark.parametrize(
    ("falsify", "changes", "message"),
    [
        ({"until": "1 clusters"}, {}, "until"),
        ({"until": "21 clusters"}, {}, "until"),
        ({"until": "budget", "shrink": True}, {}, "shrink: follows"),
        ({"until": "budget", "over": "disturbances"}, {}, "over: follows"),
        ({"until": "budget"}, {"until_counterexample": True}, "until_counterexample: falsify.until = 'budget'"),
        ({"until": "budget"}, {"clip": (0.0, 1.0)}, "hides every violation"),
    ],
)
def test_what_contradicts_it_is_refused(falsify: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        sought(falsify.pop("until"), falsify=falsify, **changes)

"""The ranks of rollouts in a campaign that runs."""

from pathlib import Path

from perfbound.orchestrator.report.collect.violations import ViolationStatistics, ranked_tests
from perfbound.orchestrator.store.read import stored_header
from tests.fakes.simulators import robustness, simulate

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}


def test_a_test_that_was_proposed_since_has_no_rank_yet(tmp_path: Path) -> None:
    """The ranks are read after the facts: by then a running campaign may have recorded rollouts of a newer test."""
    config = robustness(RIGOROUS, spot_check=0, recheck=0)
    assert simulate(tmp_path, config, lambda request: 0.3 - 0.2 * sum(request.x), noisy=False)
    header = stored_header(tmp_path)
    every = tuple(ranked_tests(tmp_path, header))
    newest = max(each.test for each in every)
    statistics = ViolationStatistics(tmp_path)
    statistics.refresh(header, lambda _, test: (0.5, 0.5) if test < newest else None)
    assert statistics.ranked == tuple(each for each in every if each.test < newest) != every

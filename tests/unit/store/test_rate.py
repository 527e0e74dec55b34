"""The rate of a campaign over its last minute of work."""

import pytest

from perfbound.orchestrator.store.progress import RECENT, rate


def test_the_rate_right_after_a_resume_is_that_of_the_minute_of_work_before() -> None:
    """Two workers that hand over their first results together must not make it a rate of hundreds."""
    before = [float(at) for at in range(100, 200)]
    assert rate(before, [99.0]) == pytest.approx(1.0)
    assert rate([*before, 902.0, 902.007], [99.0, 900.0]) == pytest.approx(1.0, rel=0.05)


def test_a_minute_after_a_resume_the_rate_is_that_of_the_session() -> None:
    before, after = [float(at) for at in range(100)], [900.0 + 0.5 * at for at in range(1, 121)]
    assert rate([*before, *after], [0.0, 900.0]) == pytest.approx(2.0)


def test_sessions_without_results_are_no_work() -> None:
    before = [float(at) for at in range(1, 31)]
    assert rate([*before, 901.0], [0.0, 300.0, 600.0, 900.0]) == pytest.approx(1.0)
    assert rate([901.0, 902.0], [0.0, 900.0]) == pytest.approx(1.0)
    assert rate(before, [0.0, 300.0]) == pytest.approx(1.0), "the last session has none yet"


def test_the_first_results_of_a_campaign_have_the_time_since_its_start() -> None:
    assert rate([10.0, 10.007], [6.0]) == pytest.approx(0.5, rel=0.01)
    assert rate([10.0], [8.0]) == 0.5
    assert rate([], [8.0]) == rate([10.0], []) == 0.0


def test_results_together_after_a_gap_count_with_the_gap() -> None:
    """As after a lost link, which ends no session."""
    assert rate([*range(100), 400.0, 400.01], [-1.0]) == pytest.approx(2 / 301.01)


def test_slow_rollouts_have_a_rate() -> None:
    assert rate([0.0, 90.0, 180.0], [-90.0]) == pytest.approx(1 / 90)


def test_of_many_results_the_latest_are_enough() -> None:
    """Those left out must not add the time since the session began."""
    assert rate([500.0 + 0.01 * at for at in range(RECENT)], [490.0]) == pytest.approx(100.0)

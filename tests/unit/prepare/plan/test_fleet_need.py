"""The arithmetic of a plan: times, limits and sizes, each against numbers by hand."""

import pytest

from perfbound.orchestrator.prepare.plan import fleet_need as plans
from perfbound.orchestrator.prepare.plan.fleet_need import (
    FleetPlan,
    Pace,
    PilotFigures,
    ProblemSize,
    batch_work,
    fleet_plan,
)
from perfbound.schemas.values import Guess

PILOT = PilotFigures(rollouts=10, seconds=10.0, fastest=9.0, startup=2.0, size=100_000.0, memory=97_000_000)

BATCHED = PilotFigures(10, 0.003, 0.002, 1.0, 3200.0, 97_000_000, added=1e-5)
"""Of a system whose rollouts cost little more together than one alone."""


def exactly(number: float) -> Guess:
    return Guess(number, number, number)


def size(tests: float = 100, per_test: int = 1, window: int = 1, **others: object) -> ProblemSize:
    return ProblemSize("robustness", exactly(tests), per_test, window, "fixed", **others)  # type: ignore[arg-type]


IN_BATCHES = size(tests=100_000, window=64 * 256, batch=256, work=batch_work(256, 3200.0))


def planned(
    workers: int,
    pilot: PilotFigures,
    problems: list[ProblemSize],
    checks: list[ProblemSize],
    hung_after: float = 10.0,
    *,
    share: float = 0.0,
) -> FleetPlan:
    return fleet_plan(workers, pilot, problems, checks, hung_after, second_opinion=share)


def ordered(guess: Guess) -> bool:
    return guess.low <= guess.middle <= guess.high


def test_one_test_in_flight_takes_as_long_with_any_number_of_workers() -> None:
    times = [planned(workers, PILOT, [size()], []).seconds for workers in (1, 2, 1000)]
    assert times[0] == times[1] == times[2]
    assert times[0].low < 100 * 10.0 < times[0].high


def test_workers_share_what_can_run_side_by_side() -> None:
    one, four, many = (planned(workers, PILOT, [size(window=8)], []) for workers in (1, 4, 100))
    assert one.useful_workers == 8
    assert one.seconds.middle == pytest.approx(4 * four.seconds.middle, rel=0.05)
    assert many.seconds == planned(8, PILOT, [size(window=8)], []).seconds


def test_problems_run_side_by_side_and_checks_one_after_the_other() -> None:
    alone = planned(100, PILOT, [size()], []).seconds.middle
    beside = planned(100, PILOT, [size(), size()], []).seconds.middle
    after = planned(100, PILOT, [size()], [size()]).seconds.middle
    assert beside == alone
    assert after == pytest.approx(2 * alone, rel=0.05)


def test_a_window_is_not_wider_than_the_tests() -> None:
    assert size(tests=3, window=64, per_test=2).at_once == 6


def test_mathematics_come_on_top_of_one_test_in_flight() -> None:
    plain = planned(4, PILOT, [size()], []).seconds
    slow = planned(4, PILOT, [size(thinking=exactly(500.0))], []).seconds
    assert slow.middle == pytest.approx(plain.middle + 500.0)
    assert slow.low == pytest.approx(plain.low + 500.0)
    assert slow.high >= plain.high + 500.0


def test_mathematics_hide_behind_the_rollouts_of_a_wide_window_at_best() -> None:
    """But not in the worst case, where nothing runs at the same time."""
    wide = [size(window=100), size(window=100, tests=1, thinking=exactly(100.0))]
    plain = [size(window=100), size(window=100, tests=1)]
    assert planned(1, PILOT, wide, []).seconds.low == planned(1, PILOT, plain, []).seconds.low
    assert planned(1, PILOT, wide, []).seconds.high >= planned(1, PILOT, plain, []).seconds.high + 100.0


def test_the_first_limit_is_the_loop_of_the_orchestrator() -> None:
    fast = PilotFigures(10, 0.1, 0.1, 1.0, 1e5, 10**8)
    few, many = (planned(workers, fast, [size(window=10_000)], []).load for workers in (10, 1000))
    assert not few.limits
    assert many.limits
    assert few.results == pytest.approx(10 / (0.1 + plans.ROUND_TRIP) * plans.RESULT_LOAD)


def test_heartbeats_of_idle_workers_are_a_load_as_well() -> None:
    """Of a large fleet they come at a longer interval, if the limit for hung workers allows that."""
    patient, default, impatient = (planned(10_000, PILOT, [size()], [], limit).load for limit in (60.0, 10.0, 1.0))
    assert [each.heartbeats_per_second for each in (patient, default, impatient)] == [625.0, 5000.0, 20_000.0]
    assert [each.limits for each in (patient, default, impatient)] == [False, False, True]
    assert impatient.heartbeats == pytest.approx(20_000 * plans.HEARTBEAT_SECONDS)


def test_a_loop_that_limits_sets_the_time() -> None:
    fast = PilotFigures(10, 0.001, 0.001, 1.0, 1e5, 10**8)
    found = planned(1000, fast, [size(tests=100_000, window=10_000)], [])
    assert found.seconds.middle >= 100_000 * plans.RESULT_SECONDS


def test_the_expected_time_is_with_the_limit_of_the_orchestrator() -> None:
    """Its threads take 250 results a second on one core, beside heartbeats."""
    fast = PilotFigures(10, 0.1, 0.1, 1.0, 1e5, 10**8)
    found = planned(200, fast, [size(tests=60_000, window=1000)], [])
    assert found.load.limits
    assert found.seconds.middle >= 60_000 * plans.RESULT_LOAD
    assert found.network < 1 / plans.RESULT_LOAD * 100_600 + 250 * 300 + 1
    assert ordered(found.seconds)


def test_second_opinions_double_the_time_but_neither_files_nor_rate() -> None:
    plain, both = (planned(4, PILOT, [size(window=8)], [size(window=50)], share=share) for share in (0.0, 1.0))
    assert both.seconds.middle == pytest.approx(2 * plain.seconds.middle, rel=0.05)
    assert both.seconds.low > 1.9 * plain.seconds.low
    assert both.second_opinions == both.rollouts == plain.rollouts
    assert (both.storage, both.load, both.network, both.useful_workers) == (
        plain.storage,
        plain.load,
        plain.network,
        plain.useful_workers,
    )


def test_no_more_rollouts_run_side_by_side_with_second_opinions() -> None:
    """A second opinion begins after the first result: three tests keep three workers busy for two rollouts."""
    plain, both = (planned(100, PILOT, [size(tests=3, window=64)], [], share=share) for share in (0.0, 1.0))
    assert both.seconds.middle - plain.seconds.middle == pytest.approx(10.0, rel=0.01)


def test_a_small_share_has_the_first_results_of_each_worker_on_top() -> None:
    """Counted in campaigns of 361 and 359 rollouts: 23 more attempts with four workers, 19 with two."""
    many, two = (planned(workers, PILOT, [size(tests=360)], [], share=0.05).second_opinions for workers in (4, 2))
    assert many.low <= 23 <= many.high
    assert two.low <= 19 <= two.high
    assert planned(1000, PILOT, [size(tests=10)], [], share=0.5).second_opinions.high == 10


def test_a_worker_that_is_alone_starts_anew_for_each_second_opinion() -> None:
    """Measured at 360 rollouts of no time: 399 s."""
    quick = PilotFigures(10, 0.001, 0.001, 1.0, 1e3, 10**7)
    found = planned(1, quick, [size(tests=360)], [], share=1.0).seconds
    assert found.low < 399 < found.high
    assert found.middle > 360


def test_storage_is_that_of_the_rollouts() -> None:
    found = planned(1, PILOT, [size(tests=1000)], [])
    assert found.rollouts == exactly(1000)
    assert found.files.low < 1000 * 100_000 < found.files.high
    assert found.storage.middle - found.files.middle == pytest.approx(460_000 + plans.REPORT_BYTES / 20)


def test_memory_has_the_matrices_of_every_method() -> None:
    none, two = (planned(1, PILOT, [size(matrices=each)] * 2, []).memory for each in (exactly(0), Guess(5e8, 0.0, 3e9)))
    assert (two.low - none.low, two.middle - none.middle, two.high - none.high) == (0.0, 1e9, 6e9)


def test_the_network_carries_results_and_heartbeats() -> None:
    found = planned(4, PILOT, [size(window=4)], [])
    assert found.network == pytest.approx(4 / 10.01 * 100_600 + 4 * 2 * 300, rel=1e-6)


@pytest.mark.parametrize("workers", [1, 3, 64, 10_000])
@pytest.mark.parametrize("seconds", [0.0, 0.001, 30.0])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_ranges_are_ordered_and_finite(workers: int, seconds: float, share: float) -> None:
    pilot = PilotFigures(1, seconds, seconds / 2, 0.5, 1e3, 10**7)
    problems = [
        ProblemSize("nominal_robustness", Guess(50, 10, 200), 1, 1, "", Guess(1.0, 0.5, 4.0), Guess(2e6, 0.0, 9e6)),
        ProblemSize("sim_gap", Guess(50, 10, 200), 2, 4, "", Guess(1.0, 0.5, 4.0), Guess(2e6, 0.0, 9e6)),
    ]
    checks = [ProblemSize("spot_check", Guess(150, 100, 200), 1, 64, "")]
    found: FleetPlan = planned(workers, pilot, problems, checks, share=share)
    assert ordered(found.second_opinions)
    for guess in (found.seconds, found.rollouts, found.files, found.storage, found.memory):
        assert ordered(guess)
        assert 0 < guess.low <= guess.high < float("inf")


def test_a_batch_shares_what_an_assignment_costs() -> None:
    """The CPU time of the orchestrator for a rollout, as in docs/performance.md."""
    assert batch_work(1, 3200.0) == 1.0
    assert batch_work(256, 3200.0) * plans.RESULT_LOAD == pytest.approx(38e-6, rel=0.1)
    assert batch_work(1024, 3200.0) * plans.RESULT_LOAD == pytest.approx(27e-6, rel=0.1)
    assert batch_work(256, 10_000.0) * plans.RESULT_LOAD == pytest.approx(74e-6, rel=0.1)
    assert Pace(2.0, 0.5, 0.1).seconds(1) == pytest.approx(2.1)
    assert Pace(2.0, 0.5, 0.1).seconds(16) == pytest.approx(0.6)


def test_batches_take_less_of_everything() -> None:
    alone = planned(2, BATCHED, [size(tests=100_000, window=256)], [])
    together = planned(2, BATCHED, [IN_BATCHES], [])
    assert together.seconds.middle < alone.seconds.middle / 20
    assert together.files.middle < alone.files.middle
    assert together.load.results_per_second > 20 * alone.load.results_per_second
    assert ordered(together.seconds)


def test_no_more_workers_are_useful_than_batches() -> None:
    assert IN_BATCHES.at_once == 64
    assert size(tests=300, window=256, batch=256).at_once == 1
    assert planned(128, BATCHED, [IN_BATCHES], []).seconds == planned(64, BATCHED, [IN_BATCHES], []).seconds

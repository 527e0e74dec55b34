"""The division of a calibration's rollouts among child processes, and the choice between two methods."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from perfbound.orchestrator.campaign import plan as plans
from perfbound.orchestrator.fleet.children.rollouts import ChildSystem
from perfbound.orchestrator.prepare.calibrate.budget import rollout_time
from perfbound.orchestrator.prepare.calibrate.calibrate import check_effort
from perfbound.orchestrator.prepare.calibrate.constants import PilotPace
from perfbound.orchestrator.prepare.calibrate.forecast import Instead
from perfbound.orchestrator.prepare.calibrate.rollouts import (
    FEWEST_OF_A_CHILD,
    CalibrationRollouts,
    RolloutBatch,
    StartRollout,
)
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.values import Guess
from perfbound.workers.systems import load_system
from tests.campaigns import config
from tests.facts import says
from tests.unit.prepare.plan.test_sizes import spec


class Recorded(CalibrationRollouts):
    """Rollouts that are only counted."""

    def _run(self, batch: RolloutBatch) -> None:
        pass


@pytest.mark.parametrize(
    ("number", "processes"),
    [(1, 1), (FEWEST_OF_A_CHILD - 1, 1), (2 * FEWEST_OF_A_CHILD, 2), (3 * FEWEST_OF_A_CHILD, 3), (1000, 3)],
)
def test_a_batch_is_divided_among_as_many_children_as_pay(tmp_path: Path, number: int, processes: int) -> None:
    system, campaign = load_system("test-function").spec, config("test-function")
    rollouts = Recorded(ChildSystem(system.name, system, 60.0, 60.0), campaign, 0, tmp_path, seed=1, workers=3)
    counted: list[int] = []
    rollouts.report = counted.append
    rollouts.clock = iter(range(0, 100, 5)).__next__
    batch = rollouts.simulate([StartRollout(test, (0.0, 0.0), 0) for test in range(number)])
    assert len(batch.parts) == processes
    assert sorted(request.test for _, requests in batch.parts for request in requests) == list(range(number))
    assert len({request.seed for _, requests in batch.parts for request in requests}) == number
    assert all(folder.is_dir() for folder, _ in batch.parts)
    assert counted == [number]
    assert rollouts.pace == PilotPace(number, 5.0, processes)
    rollouts.simulate([StartRollout(test, (1.0, 1.0), 0) for test in range(number + 1)])
    assert rollouts.pace == PilotPace(number, 5.0, processes), "later batches are mostly the start of workers"


@pytest.mark.parametrize(
    ("window", "replicates", "workers", "seconds"),
    [(1, 4, 2, 20 * 2 + 150), (1, 1, 2, 20 + 150), (5, 1, 2, 4 * 3 + 150), (100, 3, 2, 30 + 150), (1, 4, 4, 20 + 75)],
)
def test_the_time_of_a_campaign_is_that_of_its_turns_at_the_pace_of_the_pilot(
    window: int, replicates: int, workers: int, seconds: int
) -> None:
    """Each worker takes 3 s for a rollout, whatever a rollout of another system took."""
    campaign = config("test-function-rigorous").model_copy(update={"spot_check": 280, "recheck": 20})
    planned = plans.plan(campaign, load_system("test-function").spec, campaign.problems[0])
    planned = replace(planned, window=window, replicates=replicates)
    pace = PilotPace(rollouts=100 * workers, seconds=300.0, workers=workers)
    assert pace.cost == 3.0
    assert says(pace.words, f"{workers / 3.0:.2g} per second {workers} workers {100 * workers}")
    rollouts, found = rollout_time(campaign, planned, pace, tests=20)
    assert rollouts == 20 * replicates + 300
    assert found == pytest.approx(3.0 * seconds)


@pytest.mark.parametrize(("high", "tighter"), [(0.4, True), (0.5, False), (0.6, False)])
def test_another_method_is_proposed_only_if_the_worse_end_of_its_range_is_better(high: float, tighter: bool) -> None:
    assert Instead("robustness", 100, 0.5, Guess(0.3, 0.2, high), -1).is_tighter is tighter


def test_more_starts_than_their_kernel_matrices_have_room_for_are_refused_before_any_is_simulated() -> None:
    with pytest.raises(PerfboundError) as error:
        check_effort(100_000, spec(6))
    (fewer,) = re.findall(r"choose at most --rollouts (\d+)", str(error.value))
    assert says(str(error.value), f"^--rollouts 100000: GB 8 GB --rollouts {fewer}")
    check_effort(int(fewer), spec(6))

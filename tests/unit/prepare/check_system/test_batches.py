"""The finding about the batches of a vectorised system."""

import pytest

from perfbound.orchestrator.prepare.check_system.batches import judge_batches
from perfbound.orchestrator.prepare.check_system.findings import SystemFinding
from perfbound.orchestrator.prepare.check_system.measurements import Measurements
from perfbound.schemas.system_check import Against, BatchDifference, ChildRun, Measured, Trial
from tests.fakes.batches import batch_request, many, one


def judged(*against: Against, unit: bool = False, error: str = "", ended: str = "") -> SystemFinding:
    spec = many.spec.model_copy(update={"batch_is_the_unit": unit})
    batch = batch_request(spec, [(1.0,), (2.0,), (3.0,)])
    differences = tuple(
        BatchDifference(against=each, rollouts=2, place=1, column="z", time=0.5, distance=2e-13) for each in against
    )
    measured = () if ended else (Measured(differences=differences, error=error),)
    run = ChildRun(
        trials=(Trial(request=batch.single(0), batch=batch),), loaded=Measured(), measured=measured, ended=ended
    )
    found = judge_batches(Measurements(spec, (run,), limit=1.0, processors=1, batched=run))
    assert found is not None
    return found


def test_equal_rollouts_pass() -> None:
    assert judged().status == "passed"
    assert judged(unit=True).status == "passed"


@pytest.mark.parametrize("against", ["alone", "order"])
def test_a_difference_names_rollout_column_time_and_distance(against: Against) -> None:
    found = judged(against)
    assert found.status == "failed"
    for part in ("2 of 3 rollouts", "a = 2, seed 101", "z at 0.5 s by 2e-13 m"):
        assert part in found.detail
    assert "batch_is_the_unit=True" in found.remedy
    assert judged(against, unit=True).status == "passed"


@pytest.mark.parametrize("against", ["again", "others"])
def test_what_no_declaration_makes_sound_fails(against: Against) -> None:
    for unit in (False, True):
        found = judged(against, "alone", unit=unit)
        assert found.status == "failed"
        assert "batch_is_the_unit" not in found.remedy


def test_a_batch_that_fails_or_ends_its_process_fails() -> None:
    assert judged(error="ValueError: one at a time").detail == "ValueError: one at a time"
    assert judged(ended="ended by signal SIGSEGV").status == "failed"


def test_other_systems_are_not_compared() -> None:
    run = ChildRun(
        trials=(Trial(request=batch_request(one.spec, [(1.0,)]).single(0)),), loaded=Measured(), measured=(Measured(),)
    )
    found = judge_batches(Measurements(one.spec, (run,), limit=1.0, processors=1))
    assert found is not None
    assert found.status == "passed"
    assert judge_batches(Measurements(many.spec, (run,), limit=1.0, processors=1)) is None

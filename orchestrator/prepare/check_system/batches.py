"""Findings about the batches of a vectorised system: compared with their rollouts alone, bit by bit."""

from ....schemas.system_check import Against, BatchDifference, Measured, Trial
from .findings import SystemFinding, failed, passed
from .measurements import Measurements

_UNIT = (
    "let each rollout follow from its own start and seed, bit by bit; where a library computes otherwise for another "
    "size of the batch, say batch_is_the_unit=True in the decorator: a campaign then repeats only whole batches"
)
_FAULTS: dict[Against, tuple[str, str]] = {
    "again": ("differ when their batch is repeated", "draw every random number from `seeds`, and keep nothing"),
    "others": (
        "depend on the starts of others in their batch, so that they are not independent and no bound holds",
        "let nothing pass between rollouts: no step, sum or maximum over the whole batch",
    ),
    "alone": ("differ from the same ones alone", _UNIT),
    "order": ("differ from the same ones in another place of the batch", _UNIT),
}
"""What is found, and its remedy, in the order in which one of them is named."""
_OF_UNIT = ("alone", "order")
"""What may differ where the batch is the unit."""


def judge_batches(measurements: Measurements) -> SystemFinding | None:
    """Judge whether a rollout is the same in every batch, as far as the system declares it."""
    run, spec = measurements.batched, measurements.spec
    if not spec.vectorised and measurements.good:
        return passed("batches", "the rollouts of a batch are simulated one after the other")
    if run is None:
        return None
    if run.ended:
        return failed("batches", f"the process of a batch {run.ended}", "let the function take any number of rollouts")
    rolled = list(zip(run.trials, run.measured, strict=True))
    if failing := next((found for _, found in rolled if found.error), None):
        return failed("batches", failing.error, "let the function take any number of rollouts, also one")
    for against, (fault, remedy) in _FAULTS.items():
        if against in _OF_UNIT and spec.batch_is_the_unit:
            continue
        for trial, found in rolled:
            for each in found.differences:
                if each.against == against:
                    return failed("batches", _words(measurements, trial, each, fault), remedy)
    trial, found = rolled[0]
    assert trial.batch is not None
    count = f"{len(trial.batch)} rollouts"
    if spec.batch_is_the_unit:
        return passed("batches", f"{count} repeat as a batch, which is the unit{_apart(found)}")
    return passed("batches", f"{count} are the same in a batch, alone and in another order")


def _words(measurements: Measurements, trial: Trial, found: BatchDifference, fault: str) -> str:
    """Return which rollout differs, in which column, when and how far."""
    assert trial.batch is not None
    unit = next((each.unit for each in measurements.spec.columns if each.name == found.column), "")
    most = f"most at {trial.batch.single(found.place).words(measurements.spec)}: {found.column} at {found.time:g} s"
    return f"{found.rollouts} of {len(trial.batch)} rollouts {fault}; {most} by {found.distance:.2g} {unit}".rstrip()


def _apart(found: Measured) -> str:
    differing = [each for each in found.differences if each.against in _OF_UNIT]
    if not differing:
        return "; here each is the same alone as well"
    most = max(differing, key=lambda each: each.distance)
    return f"; alone or in another order {most.rollouts} differ, {most.column} by up to {most.distance:.2g}"

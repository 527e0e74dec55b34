"""A batch on this worker: from the request to the bytes of its file, together or one rollout after the other."""

from collections.abc import Callable
from typing import cast

import numpy as np

from ..schemas.amounts import amount
from ..schemas.batch import BatchRequest, largest_batch
from ..schemas.errors import ReplacedError, SimulationError, shortened
from ..schemas.ranges import MAX_FILE_BYTES
from ..schemas.real_numbers import real_array
from ..schemas.rollout import RolloutRequest
from ..schemas.trajectory.batch import Batch, encode_batch
from ..schemas.trajectory.trajectory import Trajectory, check_finite
from .faults import NOT_OF_SYSTEMS, fault_text
from .simulate import run_request_on, simulated
from .systems.base import Cancelled, Floats, Progress, SystemUnderTest, Vectorised, disturbances_of

LONGEST_REASON = 200
"""Characters of the reason of one failed rollout."""


def run_on(system: SystemUnderTest, request: RolloutRequest | BatchRequest, progress: Progress) -> bytes:
    """Simulate a rollout or a batch; raises as each of them."""
    if isinstance(request, BatchRequest):
        return run_batch_on(system, request, progress)
    return run_request_on(system, request, progress)


def run_batch_on(system: SystemUnderTest, request: BatchRequest, progress: Progress) -> bytes:
    """Simulate a batch on `system`; every exception but `Cancelled` is a failure of the system.

    A rollout that fails leaves the others as they are. The first failure is that of the batch where none succeeds.

    Raises:
        SimulationError: no rollout has a usable trajectory, or they have different time grids.
        Cancelled: raised by `progress`.

    """
    batch = simulated_batch(system, request, progress)
    return encode_batch(batch, request=request.model_dump(mode="json"), metadata=request.metadata)


def simulated_batch(system: SystemUnderTest, request: BatchRequest, progress: Progress) -> Batch:
    """Return the trajectories of a batch; raises as `run_batch_on`."""
    return _together(system, request, progress) if system.spec.vectorised else _in_turn(system, request, progress)


def _together(system: SystemUnderTest, request: BatchRequest, progress: Progress) -> Batch:
    spec = system.spec
    returned = cast(Vectorised, system).rollouts(
        request.starts,
        variant=request.variant,
        seeds=np.array(request.seeds, dtype=np.uint64),
        horizon=request.horizon,
        options=request.options,
        progress=progress,
        **disturbances_of(spec, request.drawn.T),
    )
    try:
        samples = real_array(returned)
    except ValueError as error:
        raise SimulationError(f"{spec.name} returned what {error}") from None
    columns = spec.own_columns
    if samples.ndim == 3:
        _check_size(request, samples.shape[2] - 1, samples.shape[1])
    if samples.ndim != 3 or samples.shape[::2] != (len(request), len(columns)) or not samples.shape[1]:
        wanted = f"({len(request)}, samples, {len(columns)})"
        raise SimulationError(f"{spec.name} returned an array {samples.shape} for a batch of shape {wanted}")
    time = samples[0, :, 0]
    if not (samples[:, :, 0] == time).all():
        raise SimulationError(f"{spec.name} returned different times for the rollouts of a batch; they share one grid")
    values = np.ascontiguousarray(samples[:, :, 1:].transpose(2, 0, 1))
    return _made(columns, time.copy(), values, {}, lambda place: samples[place])


def _in_turn(system: SystemUnderTest, request: BatchRequest, progress: Progress) -> Batch:
    spec = system.spec.spread(request.signals)
    columns = tuple(each.name for each in spec.columns)
    failures: dict[int, str] = {}
    time, values = np.empty(0), np.empty((0, 0, 0))
    done = _Steps(progress)
    for place in range(len(request)):
        found = _one(system, request.single(place), done)
        if isinstance(found, str):
            failures[place] = found
            continue
        samples = found.samples
        if not values.size:
            _check_size(request, len(columns) - 1, len(samples))
            time, values = samples[:, 0].copy(), np.zeros((len(columns) - 1, len(request), len(samples)))
        if not np.array_equal(samples[:, 0], time):
            raise SimulationError(
                f"{system.spec.name} has another time grid at {request.single(place).words(spec)} than before: "
                "the rollouts of a batch share one; give `batch = 1`"
            )
        values[:, place] = samples[:, 1:].T
    return _made(columns, time, values, failures, None)


def _check_size(request: BatchRequest, columns: int, samples: int) -> None:
    """Refuse a batch whose file would be too large, before all of its rollouts are simulated."""
    each = 8 * columns * samples
    most = max(largest_batch(each), 1)
    if len(request) > most:
        raise SimulationError(
            f"{len(request)} trajectories of {samples} samples are {amount(each * len(request))}, and a file has at "
            f"most {amount(MAX_FILE_BYTES)}; give `batch = {most}`, or fewer samples"
        )


def _one(system: SystemUnderTest, request: RolloutRequest, done: "_Steps") -> Trajectory | str:
    """Return the trajectory of one rollout, or the reason why it has none."""
    try:
        return simulated(system, request, done.next())
    except (Cancelled, ImportError, ReplacedError, *NOT_OF_SYSTEMS):
        raise  # of the attempt as a whole
    except SimulationError as fault:
        return shortened(str(fault) or type(fault).__name__, LONGEST_REASON)
    except BaseException as fault:  # noqa: BLE001  (any, as for a rollout alone)
        return shortened(fault_text(fault), LONGEST_REASON)


class _Steps:
    """Steps of a batch: those of its rollouts one after the other, and one for each that is done."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._before, self._steps = progress, 0, 0

    def next(self) -> Progress:
        """Return the progress of the next rollout."""
        self._before += self._steps + 1
        self._steps = 0
        self._progress(self._before)
        return self._report

    def _report(self, step: int) -> None:
        self._steps = step
        self._progress(self._before + step)


def _made(
    columns: tuple[str, ...],
    time: Floats,
    values: Floats,
    failures: dict[int, str],
    samples: Callable[[int], Floats] | None,
) -> Batch:
    """Return the batch; with `samples`, (T, n) of a rollout by its place, one that is not finite fails alone."""
    if samples is not None and not np.isfinite(values).all():
        for place in np.flatnonzero(~np.isfinite(values).all(axis=(0, 2))).tolist():
            try:
                check_finite(samples(place), columns)
            except ValueError as error:
                failures[place] = shortened(str(error), LONGEST_REASON)
            values[:, place] = 0.0
    if failures and len(failures) >= max(values.shape[1], 1):
        raise SimulationError(next(iter(failures.values())))
    try:
        return Batch(columns, time, values, failures)
    except ValueError as error:
        raise SimulationError(str(error)) from None

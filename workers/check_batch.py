"""The comparison of a batch with its rollouts: again, alone, in another order, and among others; for `check-system`."""

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..schemas.batch import BatchRequest
from ..schemas.system_check import Against, BatchDifference
from ..schemas.trajectory.batch import Batch
from .batch import simulated_batch
from .systems.base import SystemUnderTest


class Compared(NamedTuple):
    """What a batch of N rollouts differs from, and the seconds of one of its rollouts."""

    differences: tuple[BatchDifference, ...]
    seconds: float


def compared(system: SystemUnderTest, request: BatchRequest) -> Compared:
    """Simulate a batch, the same again, N batches of one, one in another order, and two with half of other starts.

    Raises:
        SimulationError: a batch has no usable trajectories.

    """
    places = range(len(request))

    def simulated(chosen: Sequence[int], starts: Sequence[tuple[float, ...]] = request.x) -> Batch:
        parts = {"x": tuple(starts[k] for k in chosen), "seeds": tuple(request.seeds[k] for k in chosen)}
        if request.disturbances:
            parts["disturbances"] = tuple(request.disturbances[k] for k in chosen)
        return simulated_batch(system, request.model_copy(update=parts), lambda _: None)

    # The first call compiles what later ones find compiled, also for a batch of one.
    whole, _ = simulated(places), simulated([0])
    begun = time.perf_counter()
    again = simulated(places)
    batched = time.perf_counter()
    alone = [simulated([place]) for place in places]
    single = (time.perf_counter() - batched) / len(places)
    # A rollout may cost as much alone as all of them together: the rest is what one more of them adds.
    seconds = max(batched - begun - single, 0.0) / max(len(places) - 1, 1)
    order = list(reversed(places))
    turned = simulated(order)
    # With the same seeds: a generator of the whole batch leaves its rollouts independent, their starts do not. One half
    # gets one start of the other: the same starts in another order would leave a sum or a maximum as it is.
    middle = len(places) // 2
    first, second = (
        simulated(places, [request.x[k] if k in kept else request.x[kept[0]] for k in places])
        for kept in (places[:middle] or places, places[middle:])
    )
    pairs: dict[Against, Iterable[tuple[int, Batch, int]]] = {
        "again": ((k, again, k) for k in places),
        "others": ((k, first if k < middle else second, k) for k in places),
        "alone": ((k, alone[k], 0) for k in places),
        "order": ((k, turned, order.index(k)) for k in places),
    }
    found = (_difference(against, whole, each) for against, each in pairs.items())
    return Compared(tuple(each for each in found if each is not None), seconds)


def _difference(against: Against, whole: Batch, pairs: Iterable[tuple[int, Batch, int]]) -> BatchDifference | None:
    """Return the largest difference of any number, and how many rollouts differ; None where all are equal."""
    found = list(_differing(whole, pairs))
    if not found:
        return None
    distance, place, column, at = max(found, key=lambda each: each[0])
    return BatchDifference(against=against, rollouts=len(found), place=place, column=column, time=at, distance=distance)


def _differing(whole: Batch, pairs: Iterable[tuple[int, Batch, int]]) -> Iterator[tuple[float, int, str, float]]:
    """Yield for each rollout that differs how far, its place, and the column and the time where it does most."""
    for place, other, there in pairs:
        if not np.array_equal(whole.time, other.time):
            size = min(len(whole.time), len(other.time))
            yield float(np.max(np.abs(whole.time[:size] - other.time[:size]))), place, "t", float(whole.time[-1])
            continue
        one, two = whole.values[:, place], other.values[:, there]
        if one.tobytes() != two.tobytes():
            column, sample = np.unravel_index(np.argmax(np.abs(one - two)), one.shape)
            distance = float(abs(one[column, sample] - two[column, sample]))
            yield distance, place, whole.columns[1:][column], float(whole.time[sample])

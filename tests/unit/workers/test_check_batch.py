"""A batch compared with itself, with its rollouts alone, in another order and among others."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.workers.check_batch import compared
from tests.fakes.batches import batch_request, many

pytestmark = pytest.mark.integration
"""A function that reports no progress has a clock, which sleeps."""

TIMES = np.arange(5) * 0.25
CALLS = iter(range(10_000))


def system(change: Callable[[Any], Any]) -> Any:
    """A system whose column has `change(a)` added, which has the size of the batch."""

    @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "", "z": ""}, step=0.25, vectorised=True)
    def shifted(a: Any, *, seeds: Any, horizon: float = 1.0) -> Any:
        y = a[:, np.newaxis] + TIMES
        return y + 0 * seeds[:, np.newaxis], y + (change(a) * np.ones(len(a)))[:, np.newaxis] * (TIMES == 0.5)

    return shifted


FAULTS: dict[str, tuple[Callable[[Any], Any], set[str]]] = {
    "none": (lambda _: 0.0, set()),
    "its size": (lambda a: 1e-3 * len(a), {"alone"}),
    "its place": (lambda a: 1e-3 * np.arange(len(a)), {"alone", "order"}),
    "the sum": (lambda a: 1e-3 * a.sum(), {"alone", "others"}),
    "the largest": (lambda a: 1e-3 * a.max(), {"alone", "others"}),
    "the call": (lambda _: 1e-3 * next(CALLS), {"again", "alone", "order", "others"}),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_a_rollout_depends_on_beside_start_and_seed(fault: str) -> None:
    change, expected = FAULTS[fault]
    shifted = system(change)
    starts = [(each,) for each in (0.0, 0.0, 1.0, 1.0, 2.0, 2.0)]
    found = compared(shifted, batch_request(shifted.spec, starts)).differences
    assert {each.against for each in found} == expected
    assert all((each.column, each.time) == ("z", 0.5) for each in found)


def test_the_largest_difference_is_named() -> None:
    shifted = system(lambda a: 1e-3 * np.arange(len(a)))
    found = compared(shifted, batch_request(shifted.spec, [(1.0,)] * 6)).differences
    (alone,) = [each for each in found if each.against == "alone"]
    assert (alone.rollouts, alone.place) == (5, 5)
    assert alone.distance == pytest.approx(5e-3)


def test_a_sound_system_has_no_difference() -> None:
    assert compared(many, batch_request(many.spec, [(1.0,), (2.0,), (0.5,)])).differences == ()


def test_every_rollout_keeps_its_disturbances() -> None:
    @pb.system(
        parameters={"a": pb.Parameter(0, 10)},
        columns={"y": ""},
        disturbances={"b": pb.Normal(0, 1)},
        vectorised=True,
    )
    def moved(a: Any, *, b: Any) -> Any:
        return a + b

    request = batch_request(moved.spec, [(1.0,), (2.0,), (0.5,)])
    request = request.model_copy(update={"disturbances": ((0.1,), (0.2,), (0.3,))})
    assert compared(moved, request).differences == ()

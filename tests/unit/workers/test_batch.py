"""A batch on a worker: equal to its rollouts alone, and one that fails leaves the others as they are."""

from typing import Any

import numpy as np
import pytest

import perfbound as pb
from perfbound.schemas import batch as requests
from perfbound.schemas.errors import DefinitionError, SimulationError
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.rollout import WithinBatch
from perfbound.schemas.trajectory.batch import Batch, read_batch
from perfbound.schemas.trajectory.trajectory import decode
from perfbound.workers.batch import run_batch_on
from perfbound.workers.simulate import run_request_on
from perfbound.workers.systems.base import Cancelled, SystemUnderTest
from tests.fakes.batches import Starts, batch_request, many, one, within

pytestmark = pytest.mark.integration
"""A function that reports no progress has a clock, which sleeps."""

STARTS: Starts = [(1.0,), (2.5,), (0.1,)]


@pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": ""}, step=0.25, vectorised=True, batch_is_the_unit=True)
def summed(a: Any, *, seeds: Any, horizon: float = 1.0) -> Any:
    """A rollout that depends on the size of its batch."""
    return (a + 0 * seeds + 1e-12 * len(a))[:, np.newaxis] * np.ones(int(horizon / 0.25) + 1)


def simulated(system: SystemUnderTest, starts: Starts, progress: Any = lambda _: None, **keys: Any) -> Batch:
    return read_batch(run_batch_on(system, batch_request(system.spec, starts, **keys), progress)).batch


@pytest.mark.parametrize("system", [one, many], ids=["in turn", "together"])
def test_each_rollout_is_the_one_that_is_simulated_alone(system: SystemUnderTest) -> None:
    request = batch_request(system.spec, STARTS, replicates=2, options={"gain": 3.0})
    file = read_batch(run_batch_on(system, request, lambda _: None))
    for place in range(len(request)):
        alone = decode(run_request_on(system, request.single(place), lambda _: None))
        assert np.array_equal(file.batch.trajectory(place).samples, alone.samples)
    assert file.metadata["first"] == "mean.3.nominal.0"


def test_a_vectorised_system_gives_what_the_same_one_gives_in_turn() -> None:
    first, second = (simulated(each, STARTS, replicates=3) for each in (one, many))
    assert list(first.digests) == list(second.digests)


def test_a_rollout_that_fails_leaves_the_others_as_they_are() -> None:
    starts: list[tuple[float, ...]] = [(1.0,), (9.5,), (8.5,), (2.0,)]
    found, without = simulated(one, starts), simulated(one, [starts[0], starts[3]], seeds=(100, 103))
    assert found.failures.keys() == {1, 2}
    assert found.failures[1].startswith("RuntimeError: the model diverged (batches.py, line ")
    assert found.failures[2].startswith("samples are not finite: z is nan at t = 0 s, row 0")
    assert [each for each in found.digests if each] == list(without.digests)
    assert simulated(many, starts[:1] + starts[2:]).failures == {1: found.failures[2]}


@pytest.mark.parametrize("system", [one, many], ids=["in turn", "together"])
def test_a_batch_without_a_rollout_is_a_failure(system: SystemUnderTest) -> None:
    with pytest.raises(SimulationError, match="not finite"):
        simulated(system, [(8.5,), (8.6,)])


def test_a_start_outside_the_spec_fails() -> None:
    assert simulated(one, [(11.0,), (1.0,)]).failures == {0: "a = 11.0 is outside [0.0, 10.0]"}
    with pytest.raises(SimulationError, match=r"a = 11\.0 is outside"):
        simulated(many, [(11.0,), (1.0,)])


def test_different_time_grids_are_refused_with_the_way_out() -> None:
    @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "m"})
    def grids(a: float, *, horizon: float = 1.0) -> dict[str, Any]:
        return {"t": np.linspace(0, horizon, int(a) + 2), "y": np.zeros(int(a) + 2)}

    with pytest.raises(SimulationError, match=r"another time grid at a = 2.*`batch = 1`"):
        simulated(grids, [(1.0,), (2.0,)])


def test_it_can_be_cancelled_and_its_steps_grow() -> None:
    steps: list[int] = []
    simulated(one, STARTS, steps.append)
    assert steps == sorted(steps)
    assert len(set(steps)) >= len(STARTS)

    def stop(step: int) -> None:
        if step > 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        simulated(one, STARTS, stop)


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (lambda n: np.zeros((n, 4, 1)), r"return \(3, samples, 2\)"),
        (lambda n: np.zeros((n + 1, 4, 2)), r"return \(3, samples, 2\)"),
        (lambda n: {"y": np.zeros((n, 4))}, "returned y, its columns are y, z"),
        (lambda n: (np.zeros((n, 4)), np.zeros((n, 3))), "differ in shape"),
        (lambda n: (np.zeros((n, 4)), np.zeros(4)), r"z has the shape \(4, 1\); return \(3, samples\)"),
        (lambda n: {"t": np.zeros(3), "y": np.zeros((n, 4)), "z": np.zeros((n, 4))}, r"t has the shape \(3,\)"),
        (lambda n: (np.zeros((n, 0)), np.zeros((n, 0))), "has the shape"),
        (lambda _: "text", "is text"),
        (lambda _: None, "the returned value"),
    ],
)
def test_what_a_vectorised_function_returns_otherwise_is_named(returned: Any, said: str) -> None:
    @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "m", "z": "m"}, step=0.25, vectorised=True)
    def wrong(a: Any) -> Any:
        return returned(len(a))

    with pytest.raises(SimulationError, match=said):
        simulated(wrong, STARTS)


def test_forms_that_a_vectorised_function_may_return() -> None:
    def each(returned: Any) -> Batch:
        @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "m"}, step=0.25, vectorised=True)
        def system(a: Any, *, horizon: float = 1.0) -> Any:
            return returned(a)

        return simulated(system, STARTS)

    wanted = each(lambda a: np.repeat(a[:, None], 5, axis=1)).values
    assert wanted.shape == (1, 3, 5)
    for form in (
        lambda a: np.repeat(a[:, None, None], 5, axis=1),
        lambda a: [np.repeat(a[:, None], 5, axis=1)],
        lambda a: {"y": np.repeat(a[:, None], 5, axis=1), "t": np.arange(5) * 0.25},
        lambda a: {"y": np.repeat(a[:, None], 5, axis=1), "t": np.tile(np.arange(5) * 0.25, (3, 1))},
    ):
        assert np.array_equal(each(form).values, wanted)
    assert each(lambda a: a).values.shape == (1, 3, 1)


def test_times_of_a_batch_are_the_same_for_all() -> None:
    @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "m"}, vectorised=True)
    def system(a: Any, *, horizon: float = 1.0) -> Any:
        return {"t": a[:, None] * np.array([0.0, horizon]), "y": np.zeros((len(a), 2))}

    with pytest.raises(SimulationError, match="different times"):
        simulated(system, STARTS)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"vectorised": False, "batch_is_the_unit": True}, "batch_is_the_unit: only a vectorised"),
        ({"after_end": "hold"}, "vectorised: not together with after_end"),
        ({"parameters": {"a": pb.Parameter(low=0, high=1, signal=True)}}, "vectorised: not together with signals"),
        ({"noisy": ["nominal"]}, "takes its `seeds` as an argument"),
    ],
)
def test_what_a_vectorised_system_cannot_be_is_refused(keys: dict[str, Any], said: str) -> None:
    given: dict[str, Any] = {"parameters": {"a": pb.Parameter(0, 1)}, "columns": {"y": "m"}, "vectorised": True}
    with pytest.raises(DefinitionError, match=said):

        @pb.system(**given | keys)
        def system(a: Any) -> Any:
            return a


def test_a_function_may_change_its_arguments() -> None:
    @pb.system(parameters={"a": pb.Parameter(0, 10)}, columns={"y": "m"}, vectorised=True)
    def system(a: Any, *, seeds: Any) -> Any:
        a += 1.0
        return a + seeds

    request = batch_request(system.spec, STARTS)
    run_batch_on(system, request, lambda _: None)
    assert request.starts.tolist() == [[1.0], [2.5], [0.1]]


def test_a_rollout_within_its_batch_is_simulated_with_all_of_it() -> None:
    request = batch_request(summed.spec, STARTS, replicates=2)
    file = read_batch(run_batch_on(summed, request, lambda _: None))
    for place in range(len(request)):
        again = request.single(place).model_copy(update={"within": within(request, place)})
        found = decode(run_request_on(summed, again, lambda _: None))
        assert np.array_equal(file.batch.trajectory(place).samples, found.samples)
        alone = decode(run_request_on(summed, request.single(place), lambda _: None))
        assert not np.array_equal(alone.samples, found.samples)


def test_only_a_vectorised_system_repeats_a_batch() -> None:
    request = batch_request(one.spec, STARTS)
    again = request.single(0).model_copy(update={"within": within(request, 0)})
    with pytest.raises(SimulationError, match="one is not vectorised, and repeats no batch"):
        run_request_on(one, again, lambda _: None)


@pytest.mark.parametrize("vectorised", [False, True])
def test_a_batch_that_is_too_large_is_refused_after_one_rollout(
    monkeypatch: pytest.MonkeyPatch,
    vectorised: bool,
) -> None:
    monkeypatch.setattr(requests, "MAX_FILE_BYTES", requests.SPARE_BYTES + 1000)
    calls: list[Any] = []

    def system(a: Any, *, horizon: float = 1.0) -> Any:
        calls.append(a)
        return np.zeros((*np.shape(a), 50, 1))

    keys: dict[str, Any] = {"parameters": {"a": pb.Parameter(0, 10)}, "columns": {"y": "m"}, "step": 0.02}
    made = pb.system(**keys, vectorised=vectorised)(system)
    with pytest.raises(SimulationError, match=r"3 trajectories of 50 samples are 1\.2 kB.*`batch = 2`"):
        simulated(made, STARTS)
    assert len(calls) == 1


WINDY = {"gust": pb.Normal(0, 1)}


@pb.system(parameters={"a": pb.Parameter(0, 10, unit="m")}, columns={"y": "m"}, disturbances=WINDY)
def windy(a: float, *, gust: float) -> float:
    return a + gust


@pb.system(
    parameters={"a": pb.Parameter(0, 10, unit="m")},
    columns={"y": "m"},
    disturbances=WINDY,
    vectorised=True,
    name="windy",
)
def many_windy(a: Any, *, gust: Any) -> Any:
    gust += a  # an array of its own, which it may change
    return gust


@pytest.mark.parametrize("system", [windy, many_windy])
def test_each_rollout_of_a_batch_has_its_own_disturbances(system: Any) -> None:
    template = RequestTemplate.of(system.spec, {}, horizon=0.0, visual=False)
    request = template.batch(RolloutId("mean", 3, "nominal", 0), [(1.0,), (2.0,)], [5, 6, 7, 8])
    drawn = [each for (each,) in request.disturbances]
    assert len(set(drawn)) == 4
    found = read_batch(run_batch_on(system, request, lambda _: None)).batch
    assert found.values[0, :, 0].tolist() == [1.0 + drawn[0], 1.0 + drawn[1], 2.0 + drawn[2], 2.0 + drawn[3]]
    for place in range(4):
        alone = request.single(place)
        assert alone.disturbances == (drawn[place],)
        again = decode(run_request_on(system, alone, lambda _: None))
        assert again.column("y").tolist() == [found.values[0, place, 0]]
    assert template.request(RolloutId("mean", 3, "nominal", 1), (1.0,), 6) == request.single(1)


def test_a_rollout_within_its_batch_has_the_disturbances_of_all() -> None:
    template = RequestTemplate.of(many_windy.spec, {}, horizon=0.0, visual=False)
    whole = WithinBatch(x=((1.0,), (2.0,)), seeds=(5, 6), place=1)
    request = template.request(RolloutId("recheck", 0, "nominal", 0), (2.0,), 6, within=whole)
    assert request.within is not None
    assert request.within.disturbances == template.disturbances("nominal", [(1.0,), (2.0,)], [5, 6])
    found = decode(run_request_on(many_windy, request, lambda _: None))
    assert found.column("y").tolist() == [2.0 + request.disturbances[0]]

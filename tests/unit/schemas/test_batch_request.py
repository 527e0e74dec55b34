"""The request for a batch: its rollouts, their starts and seeds, and the request for one of them."""

import pytest
from pydantic import ValidationError

from perfbound.schemas.batch import MOST_NUMBERS, BatchRequest, read_request
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.rollout import WithinBatch
from tests.fakes.batches import batch_request, one, within


def test_rollouts_are_in_the_order_of_tests_and_then_of_replicates() -> None:
    request = batch_request(one.spec, [(1.0,), (2.0,)], replicates=2, replicate=5, seeds=(7, 8, 9, 10))
    assert request.rollouts == [RolloutId("mean", test, "nominal", each) for test in (3, 4) for each in (5, 6)]
    assert request.starts.tolist() == [[1.0], [1.0], [2.0], [2.0]]
    assert request.rollout == "mean.3.nominal.5.4", "the retry of its first rollout has another name"


def test_the_request_for_one_is_that_of_a_rollout_alone() -> None:
    request = batch_request(one.spec, [(1.0,), (2.0,)], replicates=2, options={"gain": 3.0})
    for place, rollout in enumerate(request.rollouts):
        single = request.single(place)
        assert (single.rollout, single.seed) == (str(rollout), request.seeds[place])
        assert single.x == tuple(request.starts[place])
        assert (single.options, single.horizon, single.visual) == ({"gain": 3.0}, 1.0, False)


def test_its_json_is_read_as_it_was_written() -> None:
    request = batch_request(one.spec, [(0.1,), (0.2,)])
    assert BatchRequest.model_validate_json(request.model_dump_json()) == request


@pytest.mark.parametrize(
    "keys",
    [
        {"seeds": (1, 2)},
        {"seeds": ()},
        {"x": ((1.0,), (1.0, 2.0), (3.0,))},
        {"x": ((1.0,),) * 2000, "seeds": tuple(range(2000))},
        {"x": ((1.0,) * 31,) * 1000, "seeds": tuple(range(1000))},
        {"replicates": 0},
    ],
)
def test_what_does_not_fit_is_refused(keys: dict[str, object]) -> None:
    fields = batch_request(one.spec, [(1.0,)] * 3).model_dump() | keys
    with pytest.raises(ValidationError):
        BatchRequest(**fields)
    assert MOST_NUMBERS < 31 * 1000


def test_a_request_is_read_as_that_of_a_batch_or_of_a_rollout() -> None:
    batch = batch_request(one.spec, [(0.1,), (0.2,)])
    single = batch.single(1).model_copy(update={"within": within(batch, 1), "options": {"seeds": 1.0}})
    for request in (batch, single, batch.single(0)):
        assert read_request(request.model_dump_json()) == request
    for text in ("", "3", "{"):
        with pytest.raises(ValidationError):
            read_request(text)


@pytest.mark.parametrize("keys", [{"place": 3}, {"seeds": (1, 2)}, {"x": ((1.0,), (1.0, 2.0), (3.0,))}, {"place": -1}])
def test_a_batch_without_the_rollout_is_refused(keys: dict[str, object]) -> None:
    fields = within(batch_request(one.spec, [(1.0,)] * 3), 2).model_dump() | keys
    with pytest.raises(ValidationError):
        WithinBatch(**fields)

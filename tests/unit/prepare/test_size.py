"""The batch that is proposed: 1 where it would not pay or would leave workers idle, else what bounds it."""

import pytest

from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.prepare.plan.plan import _in_batches, _problem_size
from perfbound.orchestrator.prepare.size import BATCHES, LONG, proposed_batch, undecided_rollouts
from perfbound.schemas.result.facts import Header
from tests.unit.prepare.plan.test_sizes import parsed, spec, table


@pytest.mark.parametrize(
    ("seconds", "size", "rollouts", "workers", "batch"),
    [
        (1e-5, 3200, 10**6, 2, 1024),
        (1e-5, 100_000, 10**6, 2, 64),  # 8 MB
        (0.01, 3200, 10**6, 2, 16),  # a quarter of a second
        (2 * LONG, 3200, 10**6, 2, 1),
        (1e-5, 3200, 1, 2, 1),  # each test is decided by the one before
        (1e-5, 3200, 8, 2, 1),
        (1e-5, 3200, 64, 2, 8),
        (1e-5, 3200, 3000, 100, 4),
        (0.0, 0, 10**6, 1, 1024),
    ],
)
def test_what_bounds_a_batch(seconds: float, size: int, rollouts: int, workers: int, batch: int) -> None:
    found = proposed_batch(seconds, size, rollouts, workers)
    assert found == batch
    assert found == 1 or rollouts / found >= BATCHES * workers


def test_rollouts_are_undecided_where_all_tests_are_planned() -> None:
    for method, replicates, expected in (("sample", 1, 300), ("rigorous", 4, 4), ("kriging", 4, 1200)):
        config = parsed(table(method, 2, max_tests=300, replicates=replicates))
        assert undecided_rollouts(plans(config, spec(2)).values()) == expected


@pytest.mark.parametrize(
    ("method", "replicates", "batch", "each", "at_once"),
    [
        ("sample", 1, 64, 64, 5),
        ("sample", 1, 512, 300, 1),
        ("sample", 1, 1, 1, 256),
        ("kriging", 4, 64, 64, 19),
        ("rigorous", 8, 4, 4, 2),
        ("rigorous", 8, 64, 8, 1),
    ],
)
def test_a_plan_has_the_batches_of_its_campaign(
    method: str, replicates: int, batch: int, each: int, at_once: int
) -> None:
    config = parsed(table(method, 2, max_tests=300, replicates=replicates))
    header = Header.new(config, spec(2), {})
    (whole,) = plans(config, header.spec).values()
    found = _in_batches(header, _problem_size(header, whole, None), batch, 3200.0)
    assert (found.batch, found.at_once) == (each, at_once)

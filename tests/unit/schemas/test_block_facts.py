"""The facts of batches: each of their rollouts by its place."""

import math

import numpy as np

from perfbound.schemas.ids import RolloutId
from perfbound.schemas.ranges import DIGEST
from perfbound.schemas.result.block_facts import BatchFact, column, each_violation

ROBUSTNESS = [0.5, -0.25, 0.125, math.nan, 0.0, -1.0]
FACT = BatchFact(
    RolloutId("gap", 8, "true", 4),
    8,
    replicates=2,
    sha256="f" * 64,
    size=10,
    path="p",
    seed_column=column(np.arange(70, 76), "<i8"),
    digest_column=b"".join(bytes([place]) * DIGEST for place in range(1, 7)),
    robustness_column=column(ROBUSTNESS),
    failures=((3, "the model diverged"),),
)


def test_a_rollout_is_found_by_its_place() -> None:
    each = {fact.rollout: fact for fact in FACT.each()}
    assert [str(rollout)[4:] for rollout in FACT.rollouts] == [
        *("8.true.4", "8.true.5", "9.true.4", "9.true.5", "10.true.4", "10.true.5"),
    ]
    assert [FACT.place(rollout) for rollout in FACT.rollouts] == list(range(6))
    for place, rollout in enumerate(FACT.rollouts):
        found = FACT.alone(rollout)
        assert found == each.get(rollout)
        if found is None:
            assert place == 3, "it has failed"
            continue
        assert (found.rollout, found.seed, found.robustness) == (rollout, 70 + place, ROBUSTNESS[place])
        assert found.sha256 == f"{place + 1:02x}" * DIGEST


def test_the_violations_of_a_batch_are_those_below_zero() -> None:
    assert [FACT.place(fact.rollout) for fact in each_violation(FACT)] == [1, 5]
    assert list(each_violation(FACT)) == [fact for fact in FACT.each() if fact.violates]

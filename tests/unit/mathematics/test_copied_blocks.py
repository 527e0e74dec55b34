"""The test of copies: its predictions are probabilities, and its count of orders is exact."""

import itertools
import math
from collections import Counter
from collections.abc import Hashable, Sequence

import pytest

from perfbound.orchestrator.mathematics.bounds import copied_blocks
from perfbound.orchestrator.mathematics.bounds.copied_blocks import LARGEST, CopiedBlocks


def divisions(known: Sequence[int], length: int) -> list[tuple[int, ...]]:
    """Return every way in which results may follow: each a known class, or the next new one."""
    found: list[tuple[int, ...]] = [()]
    for _ in range(length):
        found = [(*each, k) for each in found for k in range(1 + max([*known, *each], default=-1) + 1)]
    return found


@pytest.mark.parametrize("known", [[], [0, 0, 1], [0, 1, 2, 2]])
@pytest.mark.parametrize("length", [2, 3])
def test_both_predictions_are_probabilities(known: list[int], length: int) -> None:
    counts: Counter[Hashable] = Counter(known)
    for predicted in (copied_blocks._copies, copied_blocks._different):
        total = math.fsum(math.exp(predicted(counts, block)) for block in divisions(known, length))
        assert 0.5 < total <= 1.0 + 1e-12


@pytest.mark.parametrize("length", [1, 2, 4, 6])
def test_the_ways_are_counted(length: int) -> None:
    """Of every division into classes: as many as have the same sizes."""
    every = divisions([], length)
    sizes = Counter(tuple(sorted(Counter(each).values())) for each in every)
    for each in every:
        ways = math.exp(copied_blocks._log_ways(Counter(each)))
        assert ways == pytest.approx(sizes[tuple(sorted(Counter(each).values()))])


@pytest.mark.parametrize("chances", [(0.5, 0.5), (0.9, 0.1), (0.4, 0.3, 0.3), (1.0,)])
def test_the_exact_mean_is_at_most_one(chances: tuple[float, ...]) -> None:
    """Over all outcomes of three tests with two rollouts each, and where the third start follows from them."""
    total = 0.0
    for outcome in itertools.product(range(len(chances)), repeat=6):
        test = CopiedBlocks()
        test.observe("a", outcome[:2])
        test.observe("a", outcome[2:4])
        test.observe("a" if outcome[0] == outcome[1] != outcome[2] else "b", outcome[4:])
        total += math.prod(chances[k] for k in outcome) * math.exp(test._log)
    assert total <= 1.0


def test_one_rollout_a_test_shows_nothing() -> None:
    test = CopiedBlocks()
    for _ in range(100):
        test.observe(0, ["same"])
    assert test.evidence == 1.0


def test_a_refutation_is_not_withdrawn() -> None:
    test = CopiedBlocks()
    for number in range(4):
        test.observe(0, [number] * 8)
    assert test.refutes
    for number in range(400):
        test.observe(0, [f"{number}.{place}" for place in range(8)])
    assert test.refutes
    assert test.evidence <= LARGEST

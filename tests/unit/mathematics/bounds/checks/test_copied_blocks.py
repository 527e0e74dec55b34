"""The test of copies: its predictions are probabilities, and its count of orders is exact."""

import itertools
import math
from collections import Counter
from collections.abc import Hashable, Sequence
from functools import partial

import pytest

from perfbound.orchestrator.mathematics.bounds.checks import copied_blocks
from perfbound.orchestrator.mathematics.bounds.checks.copied_blocks import LARGEST, CopiedBlocks


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
    for predicted in (partial(copied_blocks._copies, eta=0.7), copied_blocks._different):
        total = math.fsum(math.exp(predicted(counts, block)) for block in divisions(known, length))
        assert 0.5 < total <= 1.0 + 1e-12


@pytest.mark.parametrize("classes", [(0, 1), (0, 0, 1), (0, 1, 1, 0), (0, 1, 0, 2, 1), (0, 0, 0), (0, 1, 2)])
def test_no_law_gives_the_classes_a_larger_probability(classes: tuple[int, ...]) -> None:
    """Each rollout's probability given those before it: of its class, or of a new one. Over a grid of laws."""
    least, number = copied_blocks._least_surprise(Counter(classes)), max(classes) + 1
    largest = 0.0
    for parts in itertools.product(range(13), repeat=number):
        if sum(parts) > 12 or 0 in parts:
            continue
        law, found = [part / 12 for part in parts], 1.0
        for place, k in enumerate(classes):
            seen = set(classes[:place])
            found *= law[k] if k in seen else 1.0 - sum(law[j] for j in seen)
        largest = max(largest, found)
    assert largest <= math.exp(-least) * (1 + 1e-12)
    assert largest >= 0.7 * math.exp(-least), "and some law comes near"


def test_a_rule_that_reads_the_values_gains_nothing() -> None:
    """Going on where the first result was the rare one only; by the number of equal orders alone it would gain .14."""
    total = 0.0
    for outcome in itertools.product((0, 1), repeat=4):
        test = CopiedBlocks()
        test.observe("a", outcome[:2])
        if outcome[0] == 0:
            test.observe("a", outcome[2:])
        total += math.prod((0.1, 0.9)[k] for k in outcome) * math.exp(test._log)
    assert total <= 1.0


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

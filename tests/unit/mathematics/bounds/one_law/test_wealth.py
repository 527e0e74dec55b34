"""Bets on many values against one candidate, one strategy and one value after the other."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.betting import BOLD_AND_CAREFUL, CAREFUL, Past
from perfbound.orchestrator.mathematics.bounds.one_law.wealth import MOST_VALUES, Moments, Strategy, Wealth
from perfbound.orchestrator.mathematics.bounds.rounding import RICHEST
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from tests.fakes.states import blocks, sizes, state_of

MEANS = np.arange(256) / 256
UNITS = st.one_of(st.sampled_from([0.0, 0.25, 0.5, 1.0]), st.floats(0, 1))
THREE = (Strategy(0.5, 0.95, 2.0), Strategy(0.3, 0.5), Strategy(0.2, 0.1, 0.5))


def wealth(
    strategies: Sequence[Strategy] = BOLD_AND_CAREFUL,
    thresholds: Sequence[float] = (20.0, 200.0),
    means: Floats = MEANS,
) -> Wealth:
    found = Wealth(means, strategies, thresholds)
    found.limit(means)
    return found


def moments(x: Floats) -> Moments:
    return Past(1).before(x.tolist())


def played(x: Floats, past: Moments, cuts: Sequence[int], **made: Any) -> Wealth:
    found = wealth(**made)
    for part in blocks(len(x), cuts):
        found.play(x[part], past[part])
    return found


def reference(m: float, x: Floats, past: Moments, strategies: Sequence[Strategy]) -> list[list[float]]:
    """Return the wealth of every strategy at m after each value, from the definition."""
    found = [[each.share for each in strategies]]
    for value, (mean, variance, error) in zip(x.tolist(), past.tolist(), strict=True):
        row = []
        for strategy, last in zip(strategies, found[-1], strict=True):
            edge = mean + strategy.optimism * error - m
            bet = min(edge / (variance + edge * edge), strategy.cap / m) if edge > 0 else 0.0
            row.append(min(last * (1.0 + bet * (value - m)), RICHEST))
        found.append(row)
    return found[1:]


@given(st.lists(UNITS, min_size=1, max_size=60), st.lists(st.integers(1, 30), max_size=8))
@settings(max_examples=60, deadline=None)
def test_blocks_leave_the_state_of_one_value_after_the_other(values: list[float], cuts: list[int]) -> None:
    x = np.array(values)
    for strategies in (BOLD_AND_CAREFUL, CAREFUL, THREE):
        one, other = (played(x, moments(x), each, strategies=strategies) for each in ([1] * len(x), cuts))
        assert state_of(one) == state_of(other)


@pytest.mark.parametrize("seed", range(6))
def test_so_do_long_blocks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.choice([rng.beta(8, 3, 3_000), rng.choice([0.0, 1.0], 3_000, p=[0.05, 0.95]), np.linspace(0, 1, 3_000)])
    one, other = (played(x, moments(x), each) for each in ([1] * len(x), sizes(len(x), seed)))
    assert one.rejected[0] >= one.rejected[1] > 10
    assert state_of(one) == state_of(other) == state_of(played(x, moments(x), []))


@pytest.mark.parametrize("strategies", [BOLD_AND_CAREFUL, CAREFUL, THREE])
@pytest.mark.parametrize("g", [1, 100, 180, 255])
def test_the_wealth_is_that_of_one_candidate_alone(g: int, strategies: tuple[Strategy, ...]) -> None:
    x = np.random.default_rng(g).beta(6, 3, 300)
    found = played(x, moments(x), [7, 50], strategies=strategies, thresholds=(math.inf,))
    rows = reference(g / 256, x, moments(x), strategies)
    assert found.wealth[:, g].tolist() == rows[-1]
    totals = [1.0]
    for row in rows:
        total = row[0]
        for each in row[1:]:
            total += each
        totals.append(total)
    assert found.peak[g] == max(totals)


def test_a_candidate_that_is_rejected_within_a_block_keeps_its_wealth() -> None:
    x = np.random.default_rng(2).beta(8, 2, 200)
    rows, found = reference(1 / 256, x, moments(x), BOLD_AND_CAREFUL), played(x, moments(x), [], thresholds=(20.0,))
    last = next(row for row in rows if row[0] + row[1] >= 20.0)
    assert rows.index(last) < 5
    assert found.wealth[:, 1].tolist() == last
    assert found.peak[1] == last[0] + last[1]


@pytest.mark.parametrize("means", [MEANS, MEANS[::8]])
def test_a_product_is_cut_in_a_block_as_it_is_value_by_value(means: Floats) -> None:
    x = np.concatenate([np.ones(5 * MOST_VALUES), np.zeros(50), np.ones(40)])
    one, other = (played(x, moments(x), each, thresholds=(math.inf,), means=means) for each in ([1] * len(x), []))
    assert state_of(one) == state_of(other)
    assert one.peak.max() >= RICHEST
    assert np.isfinite(one.wealth).all()


def test_nothing_is_bet_where_no_mean_is_aimed_at_and_when_all_are_rejected() -> None:
    found = wealth()
    before = state_of(found)
    found.play(np.array([1.0, 0.5]), np.array([[-math.inf, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    assert state_of(found) == before
    ones = np.ones(2_500)
    found.play(ones, moments(ones))
    assert found.rejected == [255, 255]
    before = state_of(found)
    found.play(ones, moments(ones))
    assert state_of(found) == before

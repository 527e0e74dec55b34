"""Upper bound of the risk of one law: frozen values, all n at once, rounding, bad input."""

import math

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.one_law.betting import BettingSequence, Past
from perfbound.orchestrator.mathematics.bounds.one_law.risk_upper import RiskUpperBound

CLIP = (-0.05, 0.75)


def bound_of(values: list[float], risk_weight: float = 0.2, delta: float = 0.05) -> RiskUpperBound:
    bound = RiskUpperBound(CLIP, risk_weight, delta=delta)
    for value in values:
        bound.add(value)
    return bound


def a_sample(count: int, seed: int = 1) -> list[float]:
    return [float(v) for v in np.clip(np.random.default_rng(seed).normal(0.4, 0.1, count), *CLIP)]


def test_without_values_it_is_the_end_of_the_clip() -> None:
    bound = bound_of([])
    assert (bound.count, bound.mean, bound.deviation, bound.upper) == (0, 0.75, 0.0, 0.75)


def test_it_is_made_of_two_sequences_at_half_delta() -> None:
    values = a_sample(101)
    means, squares = (BettingSequence((0.025,)) for _ in range(2))
    past, past_squares = Past(), Past()
    for value in values:
        x = (0.75 - value) / 0.8
        means.observe(x, past)
        past.add(x)
    for one, other in zip(values[0::2], values[1::2], strict=False):  # the last value has no partner
        y = ((other - one) / 0.8) ** 2
        squares.observe(y, past_squares)
        past_squares.add(y)
    found = bound_of(values)
    assert found.mean == pytest.approx(0.75 - 0.8 * means.lower(), abs=2e-9)
    assert found.deviation == pytest.approx(0.8 * math.sqrt(squares.lower() / 2), abs=2e-9)
    assert found.upper == pytest.approx(found.mean - 0.2 * found.deviation, abs=2e-9)
    assert found.upper >= 0.4 - 0.2 * 0.1


def test_it_never_rises_and_a_smaller_delta_claims_less() -> None:
    values, before = a_sample(80, 2), math.inf
    bound, careful = (RiskUpperBound(CLIP, 0.2, delta=delta) for delta in (0.05, 0.001))
    for value in values:
        bound.add(value)
        careful.add(value)
        assert careful.upper >= bound.upper
        assert bound.upper <= before
        before = bound.upper


def test_the_ends_of_the_clip_are_values() -> None:
    worst = bound_of([CLIP[0]] * 50, risk_weight=1.0)
    assert CLIP[0] <= worst.upper < 0.2
    assert worst.deviation == 0.0
    assert bound_of([CLIP[1]] * 50).upper == CLIP[1]
    wide = bound_of([CLIP[0], CLIP[1]] * 50, risk_weight=1.0)
    assert 0.3 < wide.deviation <= 0.8 / math.sqrt(2)


@pytest.mark.parametrize("value", [-0.06, 0.76, math.nan])
def test_a_value_outside_of_the_clip_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="a value must be in"):
        bound_of([value])


@pytest.mark.parametrize(
    ("clip", "risk_weight", "delta", "message"),
    [
        ((0.5, 0.5), 0.2, 0.05, "clip"),
        ((-math.inf, 1.0), 0.2, 0.05, "clip"),
        (CLIP, -0.1, 0.05, "risk_weight"),
        (CLIP, 0.2, 0.0, "delta"),
        (CLIP, 0.2, 1.0, "delta"),
    ],
)
def test_bad_input_is_named(clip: tuple[float, float], risk_weight: float, delta: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RiskUpperBound(clip, risk_weight, delta=delta)

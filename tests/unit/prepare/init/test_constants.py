"""The constants that a pilot proposes: they contradict none of its values, and are numbers as a person writes them."""

from decimal import ROUND_CEILING, ROUND_FLOOR
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.prepare.init import constants
from perfbound.orchestrator.prepare.init.constants import Constants
from perfbound.schemas.system import Parameter
from perfbound.schemas.trajectory.trajectory import Trajectory

BOX = tuple(Parameter(name=name, low=low, high=high) for name, low, high in (("a", -1.0, 0.1), ("b", 5.0, 60.0)))
LENGTHS = tuple(constants.length_scales(BOX).values())
STARTS = np.array(constants.pilot_starts(BOX))


def proposed(values: Any, *, noisy: bool = True, half_range: float = 1e9) -> Constants:
    return constants.proposed(LENGTHS, STARTS, np.asarray(values, dtype=float), noisy=noisy, half_range=half_range)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_the_starts_are_distinct_in_the_box_and_contain_corners(count: int) -> None:
    parameters = tuple(Parameter(name=f"p{k}", low=0.1 * k, high=0.1 * k + 0.7) for k in range(count))
    starts = constants.pilot_starts(parameters)
    assert starts == constants.pilot_starts(parameters)
    assert len(set(starts)) == len(starts) >= constants.INNER + 2
    for start in starts:
        assert all(each.low <= value <= each.high for each, value in zip(parameters, start, strict=True))
    ends = [{each.low, each.high} for each in parameters]
    assert sum(all(value in end for value, end in zip(start, ends, strict=True)) for start in starts) >= 2


def test_the_constants_fit_the_values() -> None:
    rng = np.random.default_rng(1)
    means = 30 * np.sin(STARTS[:, :1]) + STARTS[:, 1:]
    values = means + rng.normal(0, 2.0, (len(STARTS), 2))
    found = proposed(values)
    assert np.abs(values.mean(axis=1) - found.prior_mean).max() <= found.rkhs_norm
    assert isinstance(found.noise_scale, float)
    assert values.std(axis=1, ddof=1).max() <= found.noise_scale <= 12.0
    assert 0 < found.alpha < found.rkhs_norm
    assert proposed(values, half_range=1.0).noise_scale == "derived", "the clip proves less noise"
    assert proposed(values[:, :1], noisy=False).noise_scale == 0.0


def test_a_rougher_objective_needs_a_larger_norm() -> None:
    smooth, rough = np.linspace(-1, 1, len(STARTS)), np.resize([-1.0, 1.0], len(STARTS))
    order = np.argsort(STARTS[:, 1])
    wave = np.empty(len(STARTS))
    wave[order] = rough
    slope = np.empty(len(STARTS))
    slope[order] = smooth
    assert proposed(wave[:, None], noisy=False).rkhs_norm > 2 * proposed(slope[:, None], noisy=False).rkhs_norm


@pytest.mark.parametrize("value", [0.0, 7.0, -1e-12, 1e9])
def test_a_constant_objective_has_constants_too(value: float) -> None:
    found = proposed(np.full((len(STARTS), 2), value))
    assert found.rkhs_norm > 0
    assert found.alpha > 0
    assert found.noise_scale == "derived", "no spread is no evidence for R = 0 where rollouts depend on the seed"
    low, high = constants.covering(np.full(3, value), 0.5, 0.25)
    assert low < value < high


@given(st.lists(st.floats(-1e9, 1e9, allow_subnormal=False), min_size=1, max_size=5), st.floats(0, 1), st.floats(0, 1))
def test_a_cover_contains_the_values_and_their_margins(values: list[float], below: float, over: float) -> None:
    low, high = constants.covering(np.array(values), below, over)
    spread = max(values) - min(values)
    slack = 1e-9 * max(map(abs, values))
    assert low <= min(values) - below * spread + slack
    assert high >= max(values) + over * spread - slack


@given(st.floats(-1e12, 1e12, allow_subnormal=False), st.floats(1e-6, 1e12))
def test_a_rounded_number_is_near_and_on_its_side(value: float, scale: float) -> None:
    down, up = constants.rounded(value, scale, ROUND_FLOOR), constants.rounded(value, scale, ROUND_CEILING)
    assert down <= value <= up
    assert up - down <= 0.11 * max(scale, 1e-9 * abs(value))
    assert float(repr(up)) == up


def trajectory(*times: float) -> Trajectory:
    return Trajectory(("t", "a"), np.array([[time, 0.0] for time in times]))


@pytest.mark.parametrize(
    ("asked", "times", "expected"),
    [(10.0, (0.0, 5.0, 10.0), 10.0), (0.0, (0.0, 1.5, 3.0), 3.0), (10.0, (0.0,), 0.0), (0.0, (0.0,), 0.0)],
)
def test_the_horizon_follows_from_the_first_rollout(asked: float, times: tuple[float, ...], expected: float) -> None:
    assert constants.settled_horizon(asked, trajectory(*times)) == expected
    assert constants.settled_horizon(10.0, trajectory(0.0, 4.0)) == 10.0, "a short one is a fault, and no horizon"

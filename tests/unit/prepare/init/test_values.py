"""The starts of a pilot, guesses that contradict none of its values, and numbers as a person writes them."""

import math
from decimal import ROUND_CEILING, ROUND_FLOOR

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.prepare.init.values import INNER, guessed, pilot_starts, search_scale, settled_horizon
from perfbound.orchestrator.prepare.rounded import covering, rounded
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory

BOX = tuple(Parameter(name=name, low=low, high=high) for name, low, high in (("a", -1.0, 0.1), ("b", 5.0, 60.0)))
STARTS = np.array(pilot_starts(BOX))


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_the_starts_are_distinct_in_the_box_and_contain_corners(count: int) -> None:
    parameters = tuple(Parameter(name=f"p{k}", low=0.1 * k, high=0.1 * k + 0.7) for k in range(count))
    starts = pilot_starts(parameters)
    assert starts == pilot_starts(parameters)
    assert len(set(starts)) == len(starts) >= INNER + 2
    for start in starts:
        assert all(each.low <= value <= each.high for each, value in zip(parameters, start, strict=True))
    ends = [{each.low, each.high} for each in parameters]
    assert sum(all(value in end for value, end in zip(start, ends, strict=True)) for start in starts) >= 2


@pytest.mark.parametrize("value", [0.0, 7.0, -1e-12, 1e9])
def test_a_guess_for_a_constant_objective_has_constants_too(value: float) -> None:
    found = {each.key: each.value for each in guessed(np.full((len(STARTS), 2), value), noisy=True, why="a guess")}
    assert float(str(found["rkhs_norm"])) > 0
    assert float(str(found["alpha"])) > 0
    assert found["noise_scale"] == "derived", "no spread is no evidence for R = 0 where rollouts depend on the seed"
    low, high = covering(np.full(3, value), 0.5, 0.25)
    assert low < value < high


def test_a_guess_contradicts_no_value_of_the_pilot() -> None:
    means = 30 * np.sin(STARTS[:, :1]) + STARTS[:, 1:]
    found = {each.key: each for each in guessed(np.hstack([means, means]), noisy=False, why="a guess")}
    centre, norm = float(str(found["prior_mean"].value)), float(str(found["rkhs_norm"].value))
    assert np.abs(means - centre).max() < norm
    assert found["noise_scale"].value == 0.0
    assert {found[key].why for key in ("alpha", "prior_mean", "rkhs_norm")} == {"a guess"}


@given(st.lists(st.floats(-1e9, 1e9, allow_subnormal=False), min_size=1, max_size=5), st.floats(0, 1), st.floats(0, 1))
def test_a_cover_contains_the_values_and_their_margins(values: list[float], below: float, over: float) -> None:
    low, high = covering(np.array(values), below, over)
    spread = max(values) - min(values)
    slack = 1e-9 * max(map(abs, values))
    assert low <= min(values) - below * spread + slack
    assert high >= max(values) + over * spread - slack


@given(st.floats(-1e12, 1e12, allow_subnormal=False), st.floats(1e-6, 1e12))
def test_a_rounded_number_is_near_and_on_its_side(value: float, scale: float) -> None:
    down, up = rounded(value, scale, ROUND_FLOOR), rounded(value, scale, ROUND_CEILING)
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
    assert settled_horizon(asked, trajectory(*times)) == expected
    assert settled_horizon(10.0, trajectory(0.0, 4.0)) == 10.0, "a short one is a fault, and no horizon"


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("always (speed < 120 or rpm < 4750)", {"rpm": 5300.0, "speed": 98.0}),
        ("always (speed < 120 and rpm < 4750)", {}),  # two parts, each with a unit of its own
        ("always (speed < 120 or 2 * speed > 3)", {}),
        ("always (speed < 120 or still > 1)", {"speed": 98.0, "still": 1.0}),
        ("always (speed < 120 or endless > 1)", {"endless": 1.0, "speed": 98.0}),
        ("always (speed < 120 or gear == 1)", {"gear": 3.0, "speed": 98.0}),
        ("always (speed < 120 or slow < 60)", {}),
        ("always (speed < 120 or 1 < 2)", {}),
    ],
)
def test_a_search_compares_predicates_by_the_spans_of_their_columns(formula: str, expected: dict[str, float]) -> None:
    spans = {"speed": 97.3, "rpm": 5210.0, "still": 1e-12, "endless": math.inf, "gear": 3.0, "slow": 51.0}
    units = {name: "discrete" if name == "gear" else "1" for name in spans}
    spec = SystemSpec(
        name="car",
        doc="",
        parameters=BOX,
        columns=(Column(name="t", unit="s"), *(Column(name=name, unit=unit) for name, unit in units.items())),
        max_horizon=9,
    )
    assert search_scale(formula, spec, {"t": 4.0, **spans}) == expected

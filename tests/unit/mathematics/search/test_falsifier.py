"""The search for a start that fails: what a proposal depends on, and what it must survive."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.orchestrator.mathematics.search import candidates, falsifier
from perfbound.orchestrator.mathematics.search.candidates import PARENTS, Inputs
from perfbound.orchestrator.mathematics.search.falsifier import ARM, Falsifier, Point
from perfbound.orchestrator.mathematics.search.goal import ALONE, Every, Part
from perfbound.orchestrator.mathematics.search.models import Models, _deviations, _improvement
from perfbound.orchestrator.mathematics.search.portfolio import Arm, Portfolio
from perfbound.orchestrator.mathematics.search.surrogate import Surrogate, _likelihood, fitted, prior_mode
from perfbound.orchestrator.mathematics.search.warp import warped

LOW, HIGH = (-2.0, 10.0, 0.0), (3.0, 11.0, 1e-3)


def bowl(point: Point) -> float:
    """A margin whose least value, at 30 % of every range, is just above 0."""
    unit = (np.array(point) - LOW) / (np.array(HIGH) - LOW)
    return float(np.sum((unit - 0.3) ** 2)) + 0.01


def searched(tests: int, *, seed: int = 1, asked: int = 1) -> tuple[Falsifier, list[Point]]:
    """Return a search after some tests, and these; `asked` times for each proposal."""
    search, points = Falsifier(LOW, HIGH, seed=seed), []
    for _ in range(tests):
        point = [search.propose() for _ in range(asked)][-1]
        search.observe(point, bowl(point))
        points.append(point)
    return search, points


@pytest.mark.rest
def test_the_same_seed_and_observations_give_the_same_bits_however_often_one_asks() -> None:
    assert searched(60)[1] == searched(60, asked=2)[1]
    assert searched(12)[1] != searched(12, seed=2)[1]


@pytest.mark.rest
def test_a_search_that_is_fed_recorded_tests_goes_on_as_the_first_one() -> None:
    search, points = searched(30)
    resumed = Falsifier(LOW, HIGH, seed=1)
    for point in points:
        resumed.observe(point, bowl(point))
    assert resumed.propose() == search.propose()


@pytest.mark.rest
def test_every_fourth_test_is_a_start_of_the_sobol_sequence_whatever_was_observed() -> None:
    def misled(values: list[float]) -> list[Point]:
        search, points = Falsifier(LOW, HIGH, seed=3), []
        for value in values:
            points.append(search.propose())
            search.observe(points[-1], value)
        return points

    one, other = misled([1.0] * 24), misled(np.random.default_rng(0).normal(size=24).tolist())
    assert one[3::4] == other[3::4]
    assert one[4::4] != other[4::4]
    assert [Falsifier(LOW, HIGH, seed=3).is_random(test) for test in range(8)] == [False, False, False, True] * 2
    spread = (np.array(one[3::4]) - LOW) / (np.array(HIGH) - LOW)
    assert np.all(np.ptp(spread, axis=0) > 0.5)


@pytest.mark.rest
def test_tests_in_flight_are_not_repeated() -> None:
    search, _ = searched(30)
    pending: list[Point] = []
    for _ in range(12):
        pending.append(search.propose(pending))
    unit = (np.array(pending) - LOW) / (np.array(HIGH) - LOW)
    distances = np.linalg.norm(unit[:, None] - unit[None, :], axis=2) + np.eye(len(unit))
    assert distances.min() > 1e-3


def test_a_window_without_any_observation_is_spread() -> None:
    search, pending = Falsifier(LOW, HIGH, seed=5), list[Point]()
    for _ in range(8):
        pending.append(search.propose(pending))
    assert len(set(pending)) == 8


@pytest.mark.rest
@settings(max_examples=40, deadline=None)
@given(
    dimension=st.integers(1, 10),
    values=st.lists(
        st.one_of(
            st.floats(-1e308, 1e308), st.sampled_from([0.0, 0.6, 0.6, 1e-300, 1e6]), st.floats(-1.0, 1.0, width=16)
        ),
        min_size=1,
        max_size=24,
    ),
)
def test_any_finite_values_leave_the_proposals_in_the_box(dimension: int, values: list[float]) -> None:
    low, high = (-1.0,) * dimension, (0.1,) * dimension
    search = Falsifier(low, high, seed=0)
    for value in values:
        point = search.propose()
        assert all(-1.0 <= each <= 0.1 for each in point)
        search.observe(point, value)
    assert all(-1.0 <= each <= 0.1 for each in search.propose([search.propose()]))


def test_the_same_start_may_be_observed_many_times() -> None:
    search = Falsifier(LOW, HIGH, seed=0)
    for value in np.random.default_rng(0).random(30).tolist():
        search.observe((0.0, 10.5, 5e-4), value)
    assert search.propose() != (0.0, 10.5, 5e-4)


def test_no_test_in_flight_is_asked_for_again_where_the_model_is_sure_of_a_failure() -> None:
    for seed in range(6):
        search = Falsifier((0.0, 0.0), (1.0, 1.0), seed=seed)
        for _ in range(6):
            point = search.propose()
            search.observe(point, 0.3 + point[0] - point[1])
        pending: list[Point] = []
        for _ in range(6):
            pending.append(search.propose(pending))
        assert len({tuple(np.round(each, 6)) for each in pending}) == 6


def test_the_model_chooses_admitted_points_alone() -> None:
    search = Falsifier(LOW, HIGH, seed=1, admitted=lambda points: points[:, 0] < 0.0)
    for test in range(24):
        point = search.propose()
        assert point[0] < 0.0 or search.is_random(test) or test in {0, 2}
        search.observe(point, bowl(point))


def test_candidates_come_from_the_worst_starts_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    observed: list[tuple[float, Point]] = []
    checked: list[int] = []

    def watched(rng: np.random.Generator, worst: Floats, inputs: Inputs) -> Floats:
        unit = [(np.array(point) - LOW) / (np.array(HIGH) - LOW) for _, point in sorted(observed)[:PARENTS]]
        np.testing.assert_allclose(worst, unit)
        checked.append(len(worst))
        return candidates.choices_among(rng, worst, inputs)

    monkeypatch.setattr(falsifier, "choices_among", watched)
    search = Falsifier(LOW, HIGH, seed=1)
    for _ in range(24):
        point = search.propose()
        observed.append((bowl(point), point))
        search.observe(point, bowl(point))
    assert max(checked) == PARENTS


def test_while_all_values_are_equal_starts_are_spread_over_the_box() -> None:
    search, points = Falsifier((0.0,) * 14, (1.0,) * 14, seed=1), []
    for _ in range(48):
        points.append(search.propose())
        search.observe(points[-1], 0.5)
    assert len(set(points)) == 48
    found = np.array(points)
    # The first corner is the model's; those with shapes have some ends.
    shapes = found[8::8]
    assert np.all(((shapes == 0.0) | (shapes == 1.0)).any(axis=1))
    sobol = found[[test for test in range(2, 48) if test % 4 != 3 and test % 8]]
    assert np.all((sobol > 0.0) & (sobol < 1.0))
    # Neighbours in the sequence are in opposite halves, so that each half of each range has half of them.
    assert np.all(np.abs((sobol < 0.5).mean(axis=0) - 0.5) < 0.05)


def test_starts_of_some_arms_are_chosen_by_no_model() -> None:
    def proposed(first: float) -> list[Point]:
        search, points = Falsifier(LOW, HIGH, seed=1), list[Point]()
        for test in range(60):
            points.append(search.propose())
            search.observe(points[-1], 1.0 + bowl(points[-1]) if test else first)
        return points

    # With the least value at test 0 none of the others is a gain, whatever it is, so that the arms are the same.
    arms = Portfolio([1, ARM], parts=1)
    for test, (one, other) in enumerate(zip(proposed(0.5), proposed(-5.0), strict=True)):
        if test <= 2 or test % 4 == 3:
            continue
        arm = arms.arm(test)
        assert (one == other) == (arm in {Arm.SHAPED, Arm.ANYWHERE}), test
        arms.observe(arm, 0.0)


def test_the_second_start_is_a_corner_where_inputs_stay() -> None:
    for seed in range(8):
        search = Falsifier((0.0,) * 9, (1.0,) * 9, seed=seed, signals=[range(8)])
        pending = [search.propose()]
        corner = search.propose(pending)
        assert set(corner) <= {0.0, 1.0}
        assert sum(a != b for a, b in pairwise(corner[:8])) <= 4
        search.observe(pending[0], 1.0)
        assert search.propose() == corner


def test_a_plateau_below_which_nothing_is_leads_nowhere() -> None:
    def proposed(low: float) -> list[Point]:
        search, points = Falsifier(LOW, HIGH, seed=1), list[Point]()
        for test in range(24):
            points.append(search.propose())
            search.observe(points[-1], low if test % 3 else 5.0 + bowl(points[-1]))
        return points

    assert proposed(0.5)[9:] == proposed(0.25)[9:]


def test_the_third_start_is_the_middle_where_values_differ() -> None:
    assert searched(3)[1][2] == (0.5, 10.5, 5e-4)


def test_the_unit_of_a_part_changes_no_proposal() -> None:
    def proposed(unit: float) -> list[Point]:
        search, points = Falsifier(LOW, HIGH, seed=1, goal=Every((Part(0), Part(1)))), list[Point]()
        for _ in range(16):
            points.append(search.propose())
            parts = 1.0 + points[-1][0] ** 2, unit * bowl(points[-1])
            search.observe(points[-1], bowl(points[-1]), parts)
        return points

    # By a power of two, which rounds nothing.
    assert proposed(1.0) == proposed(2.0**10)


def test_the_arm_of_the_whole_has_its_model_alone() -> None:
    rng = np.random.default_rng(1)
    points, parts = rng.random((12, 2)), rng.random((12, 2))
    several, one = Models(2, Every((Part(0), Part(1)))), Models(2, ALONE)
    for point, each in zip(points, parts, strict=True):
        several.observe(point, each.tolist(), float(each.min()))
        one.observe(point, [float(each.min())], float(each.min()))
    at = rng.random((50, 2))
    found = {arm: several.scores(arm, ())[0](at) for arm in (Arm.LIKELY, Arm.WHOLE, Arm.LOWER)}
    np.testing.assert_array_equal(found[Arm.WHOLE], one.scores(Arm.LIKELY, ())[0](at))
    np.testing.assert_array_equal(found[Arm.LOWER], one.scores(Arm.LOWER, ())[0](at))
    assert not np.array_equal(found[Arm.WHOLE], found[Arm.LIKELY])


def test_knots_of_an_input_hold_the_value_of_the_one_before() -> None:
    inputs, rng = Inputs(7, signals=[(1, 2, 3, 4)]), np.random.default_rng(0)
    held = inputs.held(rng, rng.random((400, 7)), np.ones((400, 1)))
    assert np.all(held[:, 1:5] == held[:, 1:2])
    assert all(len(set(column)) == 400 for column in held[:, [0, 1, 5, 6]].T)
    often = inputs.held(rng, rng.random((400, 7)), np.full((400, 1), 0.5))
    assert 0.4 < np.mean(often[:, 1:4] == often[:, 2:5]) < 0.6


def test_values_of_parts_are_those_of_the_goal() -> None:
    alone, parted = Falsifier(LOW, HIGH, seed=0), Falsifier(LOW, HIGH, seed=0, goal=Every((Part(0), Part(1))))
    for search, parts in [(alone, (1.0, 2.0)), (parted, ()), (parted, (1.0,))]:
        with pytest.raises(ValueError, match="values of parts for a goal"):
            search.observe((0.0, 10.5, 5e-4), 1.0, parts)
    with pytest.raises(ValueError, match="finite"):
        parted.observe((0.0, 10.5, 5e-4), 1.0, (1.0, float("inf")))


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        ((), (), "one low and one high"),
        ((0.0,), (1.0, 2.0), "one low and one high"),
        ((0.0,), (0.0,), "below its high end"),
        ((0.0,), (float("inf"),), "below its high end"),
    ],
)
def test_a_box_that_is_none_is_refused(low: Point, high: Point, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Falsifier(low, high, seed=0)


def test_what_cannot_be_observed_is_refused_and_changes_nothing() -> None:
    search, _ = searched(10)
    before = search.propose()
    for point, value in [((0.0, 10.5, 5e-4), float("nan")), ((0.0, 12.0, 5e-4), 1.0), ((0.0,), 1.0)]:
        with pytest.raises(ValueError, match=r"a search needs finite|not in the box"):
            search.observe(point, value)
    assert search.observations == 10
    assert search.propose() == before
    with pytest.raises(ValueError, match="random_every"):
        Falsifier(LOW, HIGH, seed=0, random_every=0)


def test_the_gradient_of_the_likelihood_is_that_of_its_values() -> None:
    rng = np.random.default_rng(0)
    points, values = rng.random((12, 3)), rng.normal(size=12)
    squares = np.stack([(column[:, None] - column[None, :]) ** 2 for column in points.T])
    theta = prior_mode(3) + rng.normal(size=4) * 0.3
    found = _likelihood(theta, squares, values)[1]
    for axis in range(4):
        step = 1e-5 * np.eye(4)[axis]
        ends = [_likelihood(theta + sign * step, squares, values)[0] for sign in (-1, 1)]
        assert found[axis] == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-4, abs=1e-6)


def test_length_scales_follow_the_data() -> None:
    rng = np.random.default_rng(1)
    points = rng.random((60, 2))
    values = np.sin(12 * points[:, 0])  # the second parameter matters nothing
    lengths = np.exp(fitted(points, values, prior_mode(2))[:-1])
    assert lengths[1] > 3 * lengths[0]


def test_a_test_in_flight_moves_no_mean_and_takes_the_variance_away() -> None:
    rng = np.random.default_rng(2)
    points, values, asked = rng.random((20, 2)), rng.normal(size=20), rng.random((5, 2))
    theta = prior_mode(2)
    without, within = Surrogate(theta, points, values), Surrogate(theta, points, values, list(asked[:1]))
    assert without.moments(asked)[0] == pytest.approx(within.moments(asked)[0], abs=1e-9)
    assert np.all(within.moments(asked)[1] <= without.moments(asked)[1] + 1e-12)
    assert within.moments(asked)[1][0] < 0.1 * without.moments(asked)[1][0]


def test_acquisition_functions_are_those_of_their_formulas() -> None:
    rng = np.random.default_rng(3)
    model = Surrogate(prior_mode(1), rng.random((6, 1)), rng.normal(size=6))
    asked = rng.random((50, 1))
    mean, sd = model.moments(asked)
    for level in (-0.5, 0.3):
        u = (level - mean) / sd
        assert _deviations(model, asked, level) == pytest.approx(u)
        with np.errstate(divide="ignore"):
            exact = np.log(sd * (u * norm.cdf(u) + norm.pdf(u)))
        near = u > -5  # beyond, the plain formula has lost its digits
        assert _improvement(model, asked, level)[near] == pytest.approx(exact[near], rel=1e-5)
    far = _improvement(model, asked, -1e5)
    assert np.all(np.isfinite(far))


def test_an_outlier_leaves_the_scale_of_the_low_values() -> None:
    values = np.array([0.2, 0.3, 0.5, 0.8, 1.0])
    plain, spoiled = warped(values)[0], warped(np.append(values, 1e6))[0]
    assert np.ptp(spoiled[:3]) > 0.05 * np.ptp(plain[:3])


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=30), st.floats(1e-3, 1e3))
def test_warping_keeps_the_order_the_level_and_forgets_the_unit(values: list[float], unit: float) -> None:
    y = np.array(values)
    z, level = warped(y)
    order = np.argsort(y, kind="stable")
    assert np.all(np.diff(z[order]) >= -1e-9)
    assert np.all(z[y < 0] <= level + 1e-9)
    assert np.all(z[y > 0] >= level - 1e-9)
    again, same = warped(y * unit)
    assert again == pytest.approx(z, rel=1e-6, abs=1e-6)
    assert same == pytest.approx(level, rel=1e-6, abs=1e-6)

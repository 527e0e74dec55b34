"""The fit of a control: exact sums in any order, and the solution of its equations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.control.fit import Sums, roughness, solve


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_it_solves_what_numpy_solves(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(2 * size, size))
    matrix, right = rows.T @ rows + 0.1 * np.eye(size), rng.normal(size=size)
    assert solve(matrix, right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6, abs=1e-9)


def test_the_order_and_the_grouping_of_rollouts_change_no_bit() -> None:
    rng = np.random.default_rng(5)
    rows, x = rng.uniform(-1, 1, size=(400, 20)), rng.uniform(0, 1, size=400)
    whole = Sums.empty(20).plus(rows, x)
    shuffled = Sums.empty(20)
    for part in np.array_split(rng.permutation(400), 37):
        shuffled = shuffled.plus(rows[part], x[part])
    assert whole.gram.tolist() == shuffled.gram.tolist()
    assert whole.moment.tolist() == shuffled.moment.tolist()
    penalty = 0.1 * np.eye(20)
    assert whole.solved(penalty).tolist() == shuffled.solved(penalty).tolist()
    assert whole.error(whole.solved(penalty)) == shuffled.error(shuffled.solved(penalty))


def test_the_error_is_the_mean_square_of_what_is_left() -> None:
    rng = np.random.default_rng(6)
    rows, x = rng.uniform(-1, 1, size=(300, 6)), rng.uniform(0, 1, size=300)
    sums = Sums.empty(6).plus(rows, x)
    beta = sums.solved(1e-6 * np.eye(6))
    assert sums.error(beta) == pytest.approx(np.mean((x - rows @ beta) ** 2), rel=1e-3)
    first = Sums.empty(6).plus(rows[:100], x[:100])
    rest = sums.minus(first)
    assert (rest.count, rest.gram.tolist()) == (200, Sums.empty(6).plus(rows[100:], x[100:]).gram.tolist())


@pytest.mark.parametrize("knots", [1, 2, 3, 9])
def test_a_straight_line_has_no_roughness(knots: int) -> None:
    line = np.linspace(-1, 2, knots)
    assert line @ roughness(knots) @ line == pytest.approx(0.0, abs=1e-12)
    if knots > 2:
        bent = line**2
        assert bent @ roughness(knots) @ bent > 0

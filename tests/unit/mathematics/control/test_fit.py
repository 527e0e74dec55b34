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
    rows, x, starts = rng.uniform(-1, 1, size=(400, 20)), rng.uniform(0, 1, size=400), rng.integers(0, 7, size=400)
    whole, shuffled = Sums.empty(20), Sums.empty(20)
    for start in range(7):
        whole = whole.plus(start, rows[starts == start], x[starts == start])
    for place in rng.permutation(400).tolist():
        shuffled = shuffled.plus(int(starts[place]), rows[[place]], x[[place]])
    one, other = whole.within, shuffled.within
    assert (one.gram.tolist(), one.moment.tolist(), one.square) == (
        other.gram.tolist(),
        other.moment.tolist(),
        other.square,
    )
    penalty = 0.1 * np.eye(20)
    assert one.solved(penalty).tolist() == other.solved(penalty).tolist()
    assert one.variance(one.solved(penalty)) == other.variance(other.solved(penalty))


def test_what_is_left_is_the_variance_within_starts() -> None:
    rng = np.random.default_rng(6)
    rows, starts = rng.uniform(-1, 1, size=(300, 6)), np.repeat(np.arange(10), 30)
    # Differences between starts, however large, are none of the disturbances'.
    x = np.clip(0.5 + 0.04 * (starts - 4.5) + 0.05 * rows[:, 2] + rng.normal(0, 0.01, 300), 0, 1)
    sums, first = Sums.empty(6), Sums.empty(6)
    for start in range(10):
        sums = sums.plus(start, rows[starts == start], x[starts == start])
        if start < 4:
            first = first.plus(start, rows[starts == start], x[starts == start])
    within = sums.within
    beta = within.solved(1e-6 * np.eye(6))
    assert beta[2] == pytest.approx(0.05, abs=0.005)
    left = x - rows @ beta
    by_start = np.concatenate([left[starts == start] - left[starts == start].mean() for start in range(10)])
    assert within.variance(beta) == pytest.approx(float(by_start @ by_start) / 290, rel=1e-3)
    rest = sums.minus(first)
    assert (rest.count, sorted(rest.starts), rest.within.free) == (180, [4, 5, 6, 7, 8, 9], 174)
    assert within.first(2).solved(np.eye(2)).shape == (2,)


@pytest.mark.parametrize("knots", [1, 2, 3, 9])
def test_a_straight_line_has_no_roughness(knots: int) -> None:
    line = np.linspace(-1, 2, knots)
    assert line @ roughness(knots) @ line == pytest.approx(0.0, abs=1e-12)
    if knots > 2:
        bent = line**2
        assert bent @ roughness(knots) @ bent > 0

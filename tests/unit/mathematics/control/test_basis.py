"""Hat functions of scores: a partition of 1, with exact means under the law of the score."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, stats

from perfbound.orchestrator.mathematics.control.basis import choice_basis, normal_basis

NUMBERS = st.lists(st.floats(-8, 8), min_size=1, max_size=30)


@pytest.mark.parametrize("knots", [2, 3, 7, 13])
def test_the_means_of_a_normal_score_are_their_integrals(knots: int) -> None:
    basis = normal_basis(knots)
    for j, mean in enumerate(basis.means.tolist()):

        def weighted(t: float, place: int = j) -> float:
            return float(basis.hats(np.array([t]))[0, place] * stats.norm.pdf(t))

        pieces = [-9.0, *basis.knots.tolist(), 9.0]
        found = sum(integrate.quad(weighted, a, b, epsabs=1e-13)[0] for a, b in pairwise(pieces))
        assert mean == pytest.approx(found, abs=1e-12)
    assert basis.means.sum() == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("knots", [2, 3, 7, 13])
def test_the_variance_of_a_function_of_a_normal_score_is_its_integral(knots: int) -> None:
    basis, levels = normal_basis(knots), np.cos(np.arange(knots) * 1.7) + 3.0
    pieces = [-9.0, *basis.knots.tolist(), 9.0]

    def moment(power: int) -> float:
        def weighted(t: float) -> float:
            return float((basis.hats(np.array([t]))[0] @ levels) ** power * stats.norm.pdf(t))

        return float(sum(integrate.quad(weighted, a, b, epsabs=1e-13)[0] for a, b in pairwise(pieces)))

    assert basis.variance(levels) == pytest.approx(moment(2) - moment(1) ** 2, abs=1e-10)


@given(NUMBERS, st.integers(2, 13))
def test_hats_are_a_partition_and_linear_between_knots(scores: list[float], knots: int) -> None:
    basis, t = normal_basis(knots), np.array(scores)
    hats = basis.hats(t)
    assert hats.sum(axis=1) == pytest.approx(np.ones(len(t)))
    assert ((hats >= 0.0) & (hats <= 1.0)).all()
    assert hats @ basis.knots == pytest.approx(np.clip(t, basis.knots[0], basis.knots[-1]))


@given(st.lists(st.floats(0.01, 1), min_size=1, max_size=40))
def test_the_means_of_choices_are_their_probabilities(weights: list[float]) -> None:
    shares = np.array(weights) / sum(weights)
    basis = choice_basis(shares.tolist())
    numbers = np.arange(float(len(shares)))
    assert basis.means == pytest.approx(shares @ basis.hats(numbers))
    function = basis.hats(numbers) @ np.cos(basis.knots)
    variance = shares @ (function - shares @ function) ** 2
    assert basis.variance(np.cos(basis.knots)) == pytest.approx(variance, abs=1e-12)
    if len(shares) <= 13:
        assert basis.hats(numbers).tolist() == np.eye(len(shares)).tolist()


def test_one_value_alone_has_one_constant_function() -> None:
    basis = choice_basis([1.0])
    assert basis.means.tolist() == [1.0]
    assert basis.hats(np.zeros(3)).tolist() == [[1.0]] * 3
    assert basis.hats(np.array([7.0])).tolist() == [[1.0]]
    assert basis.variance(np.array([5.0])) == 0.0

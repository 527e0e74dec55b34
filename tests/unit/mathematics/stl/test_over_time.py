"""Robustness over time and the moment that decides it, against the robustness of changed trajectories."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.stl import over_time
from perfbound.orchestrator.mathematics.stl.over_time import WorstMoment, robustness_signal, worst_moment
from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.mathematics.stl.text import text

NAMES = ("t", "x", "y")
FORMULAS = (
    "always x >= 0",
    "always[1,3] x >= 0",
    "always x >= 0 and always y <= 1",
    "always[0,2] x >= 0 and always y <= 1",
    "eventually[2,5] x <= 1",
    "not eventually x > 2",
    "not always (x > 2)",
    "x >= 1",
    "always[0,5] (x >= 1 implies eventually[0,2] y >= 1)",
    "always[0,4] (x >= 1 or always[1,2] y >= 1)",
    "eventually[0,3] (always[0,2] x >= 0)",
    "x >= 0 until y >= 1",
    "x >= 0 until[1,3] y >= 1",
    "x >= 0 until_from[2,4] y >= 1",
    "always[0,2] (x >= 0 until[0,2] y >= 1)",
    "not (x >= 0 until y >= 1) or always y >= -2",
)


def traces(samples: int = 9) -> st.SearchStrategy[NDArray[np.float64]]:
    """Trajectories whose margins all differ, so that one number decides each robustness."""
    order = st.permutations(range(2 * samples))
    return order.map(
        lambda found: np.column_stack(
            [np.arange(samples), np.array(found, dtype=np.float64).reshape(2, samples).T / 3 - [1.234, 1.111]]
        )
    )


@pytest.mark.parametrize("formula", FORMULAS)
@given(samples=traces())
def test_the_robustness_is_one_of_the_values_of_the_signal(formula: str, samples: NDArray[np.float64]) -> None:
    tree = parse_formula(formula, NAMES)
    found, expected = robustness_signal(tree, NAMES, samples), robustness(tree, NAMES, samples)
    picked = {"least": np.nanmin(found.values), "greatest": np.nanmax(found.values), "first": found.values[0]}
    assert picked[found.attained] == expected


@pytest.mark.rest
@pytest.mark.parametrize("formula", FORMULAS)
@given(samples=traces())
def test_the_robustness_changes_with_its_moment_alone(formula: str, samples: NDArray[np.float64]) -> None:
    """A small change of one number changes the robustness at the moment, in its column, and nowhere else."""
    tree = parse_formula(formula, NAMES)
    found, before = worst_moment(tree, NAMES, samples), robustness(tree, NAMES, samples)
    changing = set()
    for k in range(len(samples)):
        for column in (1, 2):
            other = samples.copy()
            other[k, column] += 1e-6
            if robustness(tree, NAMES, other) != before:
                changing.add((k, NAMES[column]))
    assert found is not None
    assert {(found.first, name) for name in found.columns} == changing
    assert found.first == found.last


@pytest.mark.parametrize("formula", FORMULAS)
@given(samples=traces(), cut=st.integers(0, 8))
def test_each_value_is_the_robustness_of_the_rest(formula: str, samples: NDArray[np.float64], cut: int) -> None:
    found = robustness_signal(parse_formula(formula, NAMES), NAMES, samples)
    if np.isnan(found.values[cut]):
        return
    rest = samples[cut:] - [samples[cut, 0], 0, 0]
    assert found.values[cut] == robustness(found.formula, NAMES, rest)


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_value_is_missing_only_where_the_formula_cannot_be_read(formula: str) -> None:
    samples = np.column_stack([np.arange(9.0), np.linspace(-1, 1, 9), np.linspace(1, -1, 9)])
    found = robustness_signal(parse_formula(formula, NAMES), NAMES, samples)
    for k in np.flatnonzero(np.isnan(found.values)):
        rest = samples[k:] - [samples[k, 0], 0, 0]
        if found.attained == "first":
            with pytest.raises(FormulaError):
                robustness(found.formula, NAMES, rest)


def test_the_window_of_an_interval_is_the_extent_of_the_signal() -> None:
    samples = np.column_stack([np.arange(5.0), np.arange(5.0)])
    found = robustness_signal(parse_formula("always[1,3] x >= 2"), ("t", "x"), samples)
    assert found.values.tolist()[1:4] == [-1.0, 0.0, 1.0]
    assert np.isnan(found.values[[0, 4]]).all()


@pytest.mark.parametrize(
    ("formula", "shown", "attained"),
    [
        ("always x <= 1 and always y <= 2", "x <= 1 and y <= 2", "least"),
        ("not eventually x > 1", "not x > 1", "least"),
        ("not always not x > 1", "x > 1", "greatest"),
        ("eventually x <= 1 or eventually y <= 2", "x <= 1 or y <= 2", "greatest"),
        ("always[0,1] x <= 1 and always y <= 2", "always[0,1] x <= 1 and always y <= 2", "first"),
    ],
)
def test_the_outermost_operator_is_taken_off(formula: str, shown: str, attained: str) -> None:
    samples = np.column_stack([np.arange(9.0), np.zeros(9), np.zeros(9)])
    found = robustness_signal(parse_formula(formula), NAMES, samples)
    assert (text(found.formula), found.attained) == (shown, attained)


def test_a_stretch_with_one_margin_is_a_moment_and_two_are_none() -> None:
    tree, t = parse_formula("always x >= 2"), np.arange(5.0)
    stopped = worst_moment(tree, ("t", "x"), np.column_stack([t, [5, 3, 1, 1, 1]]))
    assert stopped == WorstMoment(2, 4, frozenset({"x"}))
    assert worst_moment(tree, ("t", "x"), np.column_stack([t, [5, 1, 3, 1, 3]])) is None


def test_two_predicates_at_one_time_are_one_moment() -> None:
    samples = np.array([[0.0, 3.0, 3.0], [1.0, 1.0, 1.0], [2.0, 3.0, 3.0]])
    found = worst_moment(parse_formula("always (x >= 2 and y >= 2)"), NAMES, samples)
    assert found == WorstMoment(1, 1, frozenset({"x", "y"}))


def test_an_until_over_very_many_samples_has_no_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = np.column_stack([np.arange(9.0), np.zeros(9), np.arange(9.0)])
    tree = parse_formula("x >= 1 until y >= 1")
    assert worst_moment(tree, NAMES, samples) is not None
    monkeypatch.setattr(over_time, "MOST_PAIRS", 8)
    assert worst_moment(tree, NAMES, samples) is None


def test_a_single_sample_is_its_own_moment() -> None:
    found = worst_moment(parse_formula("x >= 1"), ("t", "x"), np.array([[0.0, 3.0]]))
    assert found is not None
    assert found.first == found.last == 0

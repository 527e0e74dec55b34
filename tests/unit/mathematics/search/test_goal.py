"""The parts of a formula that a search models: their minima and maxima are its robustness."""

import numpy as np
import pytest
from hypothesis import assume, given, settings

from perfbound.orchestrator.mathematics.search.goal import (
    ALONE,
    MOST,
    Every,
    Goal,
    Part,
    Some,
    goal_of,
    log_failure,
    margins,
    scaled,
    without_scale,
)
from perfbound.orchestrator.mathematics.stl.errors import FormulaError
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.mathematics.stl.text import text
from perfbound.schemas.values import DISCRETE
from tests.unit.mathematics.stl.test_brute import NAMES, draw_case, seeds


@pytest.mark.parametrize(
    ("formula", "goal", "parts"),
    [
        ("always x < 1", ALONE, ["always x < 1"]),
        (
            "always (x < 1 and y < 2)",
            Every((Part(0), Part(1))),
            ["always x < 1", "always y < 2"],
        ),
        (
            "always[0,2] x < 3 implies always[0,1] y < 2",
            Some((Part(0), Part(1))),
            ["not always[0,2] x < 3", "always[0,1] y < 2"],
        ),
        (
            "not (eventually x > 1 or always y < 0)",
            Every((Part(0), Part(1))),
            ["not eventually x > 1", "not always y < 0"],
        ),
        (
            "(always x < 3 implies always y < 1) and (always x < 3 implies always y < 2)",
            Every((Some((Part(0), Part(1))), Some((Part(0), Part(2))))),
            ["not always x < 3", "always y < 1", "always y < 2"],
        ),
        ("eventually (x > 1 and y > 1)", ALONE, ["eventually (x > 1 and y > 1)"]),
        ("historically (x < 1 and y < 1)", Every((Part(0), Part(1))), ["historically x < 1", "historically y < 1"]),
        ("once (x > 1 or y > 1)", Some((Part(0), Part(1))), ["once x > 1", "once y > 1"]),
    ],
)
def test_the_parts_of(formula: str, goal: Goal, parts: list[str]) -> None:
    found, trees = goal_of(parse_formula(formula))
    assert found == goal
    assert [text(each) for each in trees] == parts


def test_of_too_many_parts_the_whole_is_one() -> None:
    formula = " and ".join(f"always x < {number}" for number in range(MOST + 1))
    assert goal_of(parse_formula(formula)) == (ALONE, (parse_formula(formula),))


@given(seeds)
@settings(deadline=None, max_examples=300)
def test_minima_and_maxima_of_the_parts_are_the_robustness(seed: int) -> None:
    written, trace = draw_case(seed)
    tree, samples = parse_formula(written), np.array(trace)
    goal, parts = goal_of(tree)
    assume(len(parts) > 1)
    try:
        whole = robustness(tree, NAMES, samples)
    except FormulaError:
        assume(condition=False)
    values = np.array([[robustness(each, NAMES, samples) for each in parts]])
    assert margins(goal, values).tolist() == [whole]


def test_a_failure_is_likely_where_one_conjunct_or_all_disjuncts_fail() -> None:
    logs = [np.log([0.5, 0.1]), np.log([0.2, 0.3])]
    assert np.exp(log_failure(Every((Part(0), Part(1))), logs)) == pytest.approx([0.5, 0.3])
    assert np.exp(log_failure(Some((Part(0), Part(1))), logs)) == pytest.approx([0.1, 0.03])


@settings(max_examples=150, deadline=None)
@given(seeds)
def test_scaled_predicates_change_no_sign(seed: int) -> None:
    written, trace = draw_case(seed)
    formula, samples = parse_formula(written), np.array(trace)
    scale = dict(zip(NAMES, np.random.default_rng(seed).uniform(0.01, 100.0, len(NAMES)), strict=True))
    assume(without_scale(formula, scale) is None)
    try:
        plain, found = (robustness(each, NAMES, samples) for each in (formula, scaled(formula, scale)))
    except FormulaError:
        assume(condition=False)
    assert np.sign(plain) == np.sign(found)
    alike = robustness(scaled(formula, dict.fromkeys(NAMES, 4.0)), NAMES, samples)
    assert alike == pytest.approx(plain / 4.0), "of one scale they have one unit"


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("x < 3", "(3 - x) / 2 >= 0"),
        ("x >= 3", "(x - 3) / 2 >= 0"),
        ("x + y <= 3", "(3 - (x + y)) / 50 >= 0"),
        ("not y > 3", "not (y - 3) / 50 >= 0"),
        ("x == 3", "(0.5 - abs(x - 3)) / 2 >= 0"),
        ("x != 3", "(abs(x - 3) - 0.5) / 2 >= 0"),
        ("x < 3 until[1,2] y > 0", "(3 - x) / 2 >= 0 until[1,2] (y - 0) / 50 >= 0"),
        ("rise(x < 3) implies next y > 0", "rise((3 - x) / 2 >= 0) implies next (y - 0) / 50 >= 0"),
    ],
)
def test_a_predicate_is_divided_by_the_largest_scale_of_its_columns(formula: str, expected: str) -> None:
    units = {"x": DISCRETE, "y": "m"}
    assert text(scaled(parse_formula(formula, units), {"x": 2.0, "y": 50.0})) == expected


def test_a_predicate_without_a_scale_is_found() -> None:
    tree = parse_formula("always (x + y < 3 and eventually (z > 1 or 1 < 2))")
    assert without_scale(tree, {"x": 1.0, "z": 2.0}) is None
    found = without_scale(tree, {"y": 1.0})
    assert found is not None
    assert text(found) == "z > 1"


def test_a_margin_below_the_last_digit_of_the_quotients_keeps_its_sign() -> None:
    samples = np.array([[0.0, 1.0 + 2**-52]])
    assert robustness(scaled(parse_formula("x <= 1"), {"x": 3.0}), ("t", "x"), samples) < 0

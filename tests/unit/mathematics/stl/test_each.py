"""Many rollouts at once, against each of them alone: equal to the bit, with the message of each error."""

import re
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.stl import robustness
from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import EvaluatedEach, evaluated, evaluated_each
from perfbound.schemas.values import Beyond
from tests.facts import facts
from tests.unit.mathematics.stl.test_brute import render

Floats = NDArray[np.float64]

NAMES = ("t", "x", "y")
STEPS = (0.1, 0.25, 1 / 120)
SUMS: tuple[str, ...] = (
    "x",
    "y",
    "abs(x)",
    "-y",
    "x - y",
    "x * y + 1",
    "x^2",
    "abs(y)^0.3",
    "abs(x)^y",
    "2^x",
    "t",
    "x - t / 2",
    "t^2",
)
SUMS += ("max(x, y, 0.5)", "min(x, t)", "sin(x) + cos(y)", "exp(x - 3)", "sqrt(abs(y))", "tan(x) * log(x^2 + 1)")
NOT_ALWAYS_FINITE = ("1 / x", "y^0.5", "x^y", "x / t", "x^t", "t^y", "1e308 * x * 10", "log(x)", "sqrt(y)", "exp(x)")
UNITS = {"t": "s", "x": "discrete", "y": "discrete"}


class Case(NamedTuple):
    """A formula and rollouts on one grid: `t` (T,), `values` (2, R, T)."""

    text: str
    t: Floats
    values: Floats
    beyond: Beyond = "refuse"


def one_by_one(case: Case) -> EvaluatedEach:
    """Return what each rollout alone gives; raise what is none of a rollout."""
    tree, rollouts = parse_formula(case.text, UNITS), case.values.shape[1]
    found = EvaluatedEach(np.full(rollouts, np.nan), np.zeros(rollouts, dtype=np.bool_), {})
    for number in range(rollouts):
        samples = np.column_stack((case.t, *case.values[:, number]))
        try:
            found.robustness[number], found.by_tolerance[number] = evaluated(tree, NAMES, samples, case.beyond)
        except FormulaError:
            raise
        except ValueError as error:
            found.faults[number] = str(error)
    return found


def at_once(case: Case) -> EvaluatedEach:
    return evaluated_each(parse_formula(case.text, UNITS), NAMES, case.t, case.values, case.beyond)


def check_equal(found: EvaluatedEach, expected: EvaluatedEach) -> None:
    assert list(found.faults.items()) == list(expected.faults.items())
    # Of zeros the sign, too.
    assert found.robustness.tobytes() == expected.robustness.tobytes()
    assert found.by_tolerance.tolist() == expected.by_tolerance.tolist()
    assert found.robustness.dtype == np.float64
    assert found.by_tolerance.dtype == np.bool_


# ---- Random cases.

KINDS = ("exact", "float32", "accumulated")


@st.composite
def grids(draw: st.DrawFn, step: float, kind: str) -> Floats:
    """Stamps from 0 on: in equal steps, in others or with jumps; exact, rounded to float32 or summed up."""
    number = draw(st.just(0) | st.integers(5, 40))
    one = st.sampled_from([0.0, 1.0, 1.0, 2.0]) | st.floats(0.3, 2.0)
    steps = draw(st.just([1.0] * number) | st.lists(one, min_size=number, max_size=number))
    t = np.concatenate(([0.0], np.cumsum(np.array(steps, dtype=np.float64)) * step))
    if kind == "float32":
        return t.astype(np.float32).astype(np.float64)
    return np.cumsum(np.diff(t, prepend=0.0)) if kind == "accumulated" else t


def formulas(step: float, expressions: tuple[str, ...]) -> st.SearchStrategy[Any]:
    """Nested tuples, see `test_brute`, whose borders are at stamps of a uniform grid and between them."""
    sums = st.sampled_from(expressions)
    border = st.sampled_from([0, 0, 1, 2, 3, 5, 2.5]).map(lambda number: round(number * step, 9))
    ends = st.tuples(border, border).map(lambda pair: (min(pair), max(pair)))
    opened = st.tuples(ends, st.sampled_from(["[)", "(]", "()"])).map(
        lambda found: (*found[0], found[1]) if found[0][0] < found[0][1] else found[0]
    )
    interval = st.none() | ends | ends | opened | border.map(lambda low: (low, None))
    limit = st.sampled_from([0.0, 0.5, 1.0, 2.0])
    predicate = st.tuples(st.sampled_from(["<=", ">=", "<", ">"]), sums, sums | limit)
    whole = st.tuples(st.sampled_from(["==", "!="]), st.sampled_from(["x", "y", "x + y"]), st.sampled_from([0, 2]))
    return st.recursive(
        predicate if expressions is SUMS else predicate | whole,
        lambda part: st.one_of(
            st.tuples(st.sampled_from(["and", "or", "implies"]), part, part),
            st.tuples(st.just("not"), part),
            st.tuples(st.sampled_from(["next", "previous", "rise", "fall"]), part),
            st.tuples(st.sampled_from(["always", "eventually", "historically", "once"]), interval, part),
            st.tuples(st.sampled_from(["until", "until_from", "since"]), interval, part, part),
        ),
        max_leaves=5,
    )


@st.composite
def cases(draw: st.DrawFn, expressions: tuple[str, ...], special: tuple[float, ...] = ()) -> Case:
    step = draw(st.sampled_from(STEPS))
    t = draw(grids(step, draw(st.sampled_from(KINDS))))
    shape = 2, draw(st.integers(1, 9)), len(t)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    values = rng.normal(size=shape) if draw(st.booleans()) else rng.choice([-1.0, -0.0, 0.0, 0.5, 1.0, 2.0], size=shape)
    if special:
        values = np.where(rng.random(shape) < 1 / (2 * len(t)), rng.choice(special, size=shape), values)
    if draw(st.booleans()):
        # One rollout after the other in memory, as a simulator may give them.
        values = np.ascontiguousarray(values.transpose(1, 2, 0)).transpose(2, 0, 1)
    return Case(render(draw(formulas(step, expressions))), t, values, draw(st.sampled_from(["refuse", "truncate"])))


def compare(case: Case, size: int) -> None:
    refused = ""
    with patch.object(robustness, "AT_ONCE", size):
        try:
            expected = one_by_one(case)
        except FormulaError as error:
            refused = str(error)
        if refused:
            with pytest.raises(FormulaError, match=f"^{re.escape(refused)}$"):
                at_once(case)
            event("refused")
            return
        check_equal(at_once(case), expected)
    event("by tolerance" if expected.by_tolerance.any() else "by numbers")
    event("faults" if expected.faults else "no fault")


SIZES = st.sampled_from([1, 50, 2**15])


@given(cases(SUMS), SIZES)
def test_each_equals_that_rollout_alone(case: Case, size: int) -> None:
    compare(case, size)


@given(cases((*SUMS[:5], *NOT_ALWAYS_FINITE), special=(np.nan, np.inf, -np.inf, 1e308)), SIZES)
def test_each_fault_is_that_of_the_rollout_alone(case: Case, size: int) -> None:
    compare(case, size)


# ---- Cases that a person can check.


def rollouts(*of_x: list[float]) -> Floats:
    """Return the values of rollouts by their x; their y are 0."""
    x = np.array(of_x)
    return np.array([x, np.zeros_like(x)])


def of(text: str, t: list[float], values: Floats) -> EvaluatedEach:
    return at_once(Case(text, np.array(t), values))


@pytest.mark.parametrize(
    "text",
    [
        "always[0,0.3] x >= -1",
        "not eventually[0.1,0.3] x <= -1",
        "(always[0,0.3] x >= -1) or (eventually[0,0.3] x <= -1)",
        "(eventually[0,0.3] x >= 1) implies y >= 0",
        "eventually[0,0.6] always[0.1,0.3] x >= 0 and y >= -2",
        "x >= -1 until[0,0.3] y >= 1",
        "x >= -1 until_from[0.1,0.3] y >= 1",
        "always[0,0.7) x >= -2",
        "eventually(0.3,0.6] always[0,0.2) x >= 0",
        "always[0.5,0.9] once(0.1,0.3) x >= 0",
        "eventually[0.5,0.9] historically[0.1,0.3] x >= 0",
        "eventually[0.6,0.9] rise(always[0,0.3] x >= -1)",
        "always[0.6,0.9] (x >= -1 since[0,0.3) y >= 0)",
    ],
)
def test_the_tolerance_decides_the_sign_of_some_rollouts(text: str) -> None:
    values = np.random.default_rng(5).normal(size=(2, 300, 15))
    case = Case(text, (np.arange(15) * 0.1).astype(np.float32).astype(np.float64), values)
    expected = one_by_one(case)
    assert 0 < expected.by_tolerance.sum() < 300
    check_equal(at_once(case), expected)


def test_each_rollout_has_its_number_or_its_fault() -> None:
    values = rollouts([1.0, 2.0], [0.5, np.nan], [3.0, -1.0], [0.0, 4.0])
    found = of("always (x <= 2.5 and 1 / x >= 0)", [0.0, 0.1], values)
    assert found.robustness[[0, 2]].tolist() == [0.5, -1.0]
    assert np.isnan(found.robustness[[1, 3]]).all()
    assert found.faults == {
        1: "`x <= 2.5` is nan at sample 1, not a finite number",
        3: "`1 / x >= 0` is inf at sample 0, not a finite number",
    }


def test_a_rollout_with_a_fault_is_not_decided_by_the_tolerance() -> None:
    t = (np.arange(4) * 0.1).astype(np.float32).astype(np.float64).tolist()
    found = of("always[0,0.3] x >= 0", t, rollouts([1, 1, 1, -1], [1, 1, np.nan, -1], [1, 1, 1, 1]))
    assert found.by_tolerance.tolist() == [True, False, False]
    assert list(found.faults) == [1]


def test_a_column_that_the_formula_does_not_read_has_no_fault() -> None:
    values = rollouts([1.0, 2.0])
    values[1] = np.inf
    assert of("always x <= 3", [0.0, 0.1], values).faults == {}


@pytest.mark.parametrize(("text", "value"), [("1 <= 3", 2.0), ("always t <= 3", 2.5), ("1 / t <= 3 or x <= 1", np.nan)])
def test_a_predicate_of_no_rollout_counts_for_every_one(text: str, value: float) -> None:
    found = of(text, [0.0, 0.5], rollouts([0.0, 0.0], [1.0, 1.0]))
    np.testing.assert_array_equal(found.robustness, [value, value])
    assert list(found.faults) == ([0, 1] if np.isnan(value) else [])


def test_a_power_of_a_single_sample_has_the_digits_of_one_rollout() -> None:
    """The power 0.5 of -0 is 0, but numpy takes the square root, -0, where all rollouts have one exponent."""
    case = Case("x^t >= 0", np.array([0.5]), rollouts([-0.0], [2.0], [-0.0]))
    check_equal(at_once(case), one_by_one(case))


def test_no_rollout_at_all() -> None:
    found = of("always[0,0.1] x <= 1", [0.0, 0.1], np.zeros((2, 0, 2)))
    assert (found.robustness.shape, found.by_tolerance.shape, found.faults) == ((0,), (0,), {})
    with pytest.raises(ValueError, match="unknown column 'phi'"):
        evaluated_each(parse_formula("phi <= 1"), NAMES, np.zeros(2), np.zeros((2, 0, 2)))


def test_what_is_wrong_with_all_is_raised() -> None:
    values = rollouts([0.0, 1.0, 2.0], [np.nan, 1.0, 2.0])
    with pytest.raises(ValueError, match="unknown column 'phi'; known are t, x, y"):
        evaluated_each(parse_formula("x <= 1 and phi <= 1"), NAMES, np.arange(3.0), values)
    with pytest.raises(FormulaError, match="reaches to 3 s"):
        of("always[0,3] x <= 1", [0.0, 1.0, 2.0], values)
    with pytest.raises(FormulaError, match="contains no sample at t = 0 s"):
        of("always[0.25,0.75] x <= 1", [0.0, 1.0, 2.0], values)
    for times in ([0.0, 2.0, 1.0], [0.0, np.nan, 1.0]):
        assert of("eventually x >= 0", times, values).robustness[0] == 2.0
        with pytest.raises(ValueError, match=facts("times finite")):
            of("eventually[0,1] x >= 0", times, values)


@pytest.mark.parametrize(
    ("times", "shape"),
    [((3,), (3, 4, 3)), ((3,), (2, 4, 2)), ((3,), (4, 3)), ((3, 1), (2, 4, 3)), ((0,), (2, 4, 0))],
)
def test_shapes(times: tuple[int, ...], shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="do not fit 3 columns"):
        evaluated_each(parse_formula("x <= 1"), NAMES, np.zeros(times), np.zeros(shape))

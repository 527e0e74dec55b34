"""Formulas: the parser's trees and complaints, and robustness against an evaluator that shares nothing with ours."""

import contextlib
import timeit
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.stl.formula import FormulaError, columns, parse
from orchestrator.stl.robustness import robustness
from orchestrator.stl.tree import Always, And, Arithmetic, Column, Comparison, Implies, Negative, Not, Number, Or

NAMES = ("t", "x", "y")
X, Y = Column("x"), Column("y")

# A formula here is a nested tuple of strings and numbers, with a renderer and an evaluator of its own.
numbers = st.integers(0, 9).map(float)
expressions: st.SearchStrategy[Any] = st.recursive(
    st.one_of(numbers, st.sampled_from(NAMES)),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["+", "-", "*"]), inner, inner),
        st.tuples(st.just("^"), inner, st.sampled_from([0.0, 1.0, 2.0])),
        st.tuples(st.sampled_from(["neg", "abs"]), inner),
    ),
    max_leaves=4,
)
formulas: st.SearchStrategy[Any] = st.recursive(
    st.tuples(st.sampled_from(["<=", ">=", "<", ">"]), expressions, expressions),
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(["and", "or", "implies"]), inner, inner),
        st.tuples(st.sampled_from(["not", "always", "eventually"]), inner),
    ),
    max_leaves=5,
)
traces = st.lists(st.tuples(*[st.integers(-3, 3).map(float)] * 3), min_size=1, max_size=6)


OPERATIONS: dict[str, Callable[..., float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "^": lambda a, b: a**b,
    "neg": lambda a: -a,
    "abs": abs,
}


def render(node: Any) -> str:
    if not isinstance(node, tuple):
        return str(node)
    if node[0] == "neg":
        return f"(-{render(node[1])})"
    if len(node) == 2:
        return f"{node[0]} ({render(node[1])})" if node[0] == "abs" else f"({node[0]} {render(node[1])})"
    return f"({render(node[1])} {node[0]} {render(node[2])})"


def value(node: Any, sample: tuple[float, ...]) -> float:
    if isinstance(node, str):
        return sample[NAMES.index(node)]
    if isinstance(node, float):
        return node
    parts = [value(part, sample) for part in node[1:]]
    return float(OPERATIONS[node[0]](*parts))


def brute(node: Any, trace: list[tuple[float, ...]]) -> float:
    word = node[0]
    if word in {"<=", "<"}:
        return value(node[2], trace[0]) - value(node[1], trace[0])
    if word in {">=", ">"}:
        return value(node[1], trace[0]) - value(node[2], trace[0])
    if word == "not":
        return -brute(node[1], trace)
    if word in {"always", "eventually"}:
        later = [brute(node[1], trace[k:]) for k in range(len(trace))]
        return min(later) if word == "always" else max(later)
    left, right = (brute(part, trace) for part in node[1:])
    return {"and": min(left, right), "or": max(left, right), "implies": max(-left, right)}[word]


class TestRobustness:
    @given(formulas, traces)
    @settings(deadline=None, max_examples=300)
    def test_equals_the_brute_force(self, formula: Any, trace: list[tuple[float, ...]]) -> None:
        ours = robustness(parse(render(formula), NAMES), NAMES, np.array(trace))
        assert ours == pytest.approx(brute(formula, trace), rel=1e-12, abs=1e-12)

    @given(formulas, traces)
    @settings(deadline=None)
    def test_de_morgan_and_duality(self, formula: Any, trace: list[tuple[float, ...]]) -> None:
        text, samples = render(formula), np.array(trace)
        dual = robustness(parse(f"not eventually not {text}"), NAMES, samples)
        assert robustness(parse(f"always {text}"), NAMES, samples) == dual

    def test_the_segway(self) -> None:
        samples = np.array([[0.0, 0.1, 0.0], [0.1, -0.24, 0.0], [0.2, 0.2, 0.0]])
        assert robustness(parse("always (abs(x) <= 0.95)"), NAMES, samples) == pytest.approx(0.71)

    def test_a_constant_formula(self) -> None:
        assert robustness(parse("always 1 <= 3"), NAMES, np.zeros((2, 3))) == 2.0

    def test_unknown_column(self) -> None:
        with pytest.raises(ValueError, match="unknown column 'phi'; known are t, x, y"):
            robustness(parse("phi <= 1"), NAMES, np.zeros((2, 3)))

    @pytest.mark.parametrize("text", ["1 / x <= 1", "(0 - 1 - x)^0.5 <= 1", "eventually (x / x <= 1 or y <= 5)"])
    def test_a_predicate_that_is_not_finite_is_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match="at sample 0, not a finite number"):
            robustness(parse(text), NAMES, np.zeros((2, 3)))

    def test_a_nan_sample_is_refused(self) -> None:
        samples = np.zeros((3, 3))
        samples[1, 1] = np.nan
        with pytest.raises(ValueError, match="nan at sample 1"):
            robustness(parse("eventually x <= 1"), NAMES, samples)

    @pytest.mark.parametrize("shape", [(0, 3), (2, 2), (3,)])
    def test_shapes(self, shape: tuple[int, ...]) -> None:
        with pytest.raises(ValueError, match="do not fit"):
            robustness(parse("x <= 1"), NAMES, np.zeros(shape))

    def test_is_fast(self) -> None:
        tree, samples = parse("always (abs(x) <= 0.95)"), np.random.default_rng(0).random((1801, 3))
        seconds = min(timeit.repeat(lambda: robustness(tree, NAMES, samples), number=200, repeat=10)) / 200
        assert seconds <= 50e-6


class TestParser:
    @pytest.mark.parametrize(
        ("text", "tree"),
        [
            ("x<=1", Comparison("<=", X, Number(1.0))),
            ("  (x) >= .5e-1 ", Comparison(">=", X, Number(0.05))),
            ("-x^2 < 1", Comparison("<", Negative(Arithmetic("^", X, Number(2.0))), Number(1.0))),
            ("x^-1 > 0", Comparison(">", Arithmetic("^", X, Negative(Number(1.0))), Number(0.0))),
            ("x - 1 - y < 0", Comparison("<", Arithmetic("-", Arithmetic("-", X, Number(1.0)), Y), Number(0.0))),
            ("x + y * x < 0", Comparison("<", Arithmetic("+", X, Arithmetic("*", Y, X)), Number(0.0))),
            ("x / y / x < 0", Comparison("<", Arithmetic("/", Arithmetic("/", X, Y), X), Number(0.0))),
            ("x^y^x < 0", Comparison("<", Arithmetic("^", X, Arithmetic("^", Y, X)), Number(0.0))),
        ],
    )
    def test_arithmetic(self, text: str, tree: Comparison) -> None:
        assert parse(text) == tree

    def test_precedence_of_words(self) -> None:
        a, b = Comparison("<", X, Number(1.0)), Comparison("<", Y, Number(1.0))
        assert parse("x<1 and y<1 or x<1") == Or(And(a, b), a)
        assert parse("x<1 or y<1 and x<1") == Or(a, And(b, a))
        assert parse("x<1 implies y<1 implies x<1") == Implies(a, Implies(b, a))
        assert parse("not x<1 and always y<1") == And(Not(a), Always(b))
        assert parse("always (x<1 and y<1)") == Always(And(a, b))
        assert parse("((x) < (1))") == a

    def test_columns(self) -> None:
        assert columns(parse("always (abs(phi) <= 0.95) implies not (x + 1 > vx)")) == {"phi", "x", "vx"}

    @pytest.mark.parametrize(
        ("text", "position", "reason"),
        [
            ("", 0, "not complete"),
            ("x <= ", 4, "not complete"),
            ("always (x <= 1", 14, r"'\)' expected"),
            ("x <= 1)", 6, "unexpected"),
            ("always x", 7, "compare it with"),
            ("x <= 1 and y", 11, "compare it with"),
            ("1 + (x <= 1) <= 2", 4, "number is needed"),
            ("(x <= 1) + 2 <= 2", 0, "number is needed"),
            ("0 <= x <= 1", 7, "do not chain"),
            ("x == 1", 2, "equality"),
            ("x <= 1 & y <= 1", 7, "write `and`"),
            ("x <= 1 # y", 7, "unexpected character '#'"),
            ("always[0,5] x <= 1", 6, "time interval comes in a later version"),
            ("x <= 1 until y <= 1", 7, "`until` comes in a later version"),
            ("until", 0, "`until` comes in a later version"),
            ("sin(x) <= 1", 0, "unknown function 'sin'"),
            ("abs x <= 1", 4, r"'\(' expected"),
            ("x <= 1 and zz <= 1", 11, "unknown column 'zz'; known are t, x, y"),
            ("x <= 1e999", 5, "too large"),
            ("x <= 2y", 6, "unexpected 'y'"),
            ("(" * 60 + "x", 41, "levels of nesting"),
            ("not " * 60 + "x <= 1", 164, "levels of nesting"),
            ("+".join("x" * 600), 1000, "more than 1000"),
        ],
    )
    def test_errors_point_at_the_place(self, text: str, position: int, reason: str) -> None:
        with pytest.raises(FormulaError, match=reason) as caught:
            parse(text, NAMES)
        assert caught.value.position == position
        assert str(caught.value).splitlines()[2].index("^") == position + 2

    def test_the_caret_stands_under_its_own_line(self) -> None:
        with pytest.raises(FormulaError) as caught:
            parse("always (\n\tx <= 1 and\n\ty ? 2)", NAMES)
        assert str(caught.value) == "specification: unexpected character '?'\n   y ? 2)\n     ^"

    @given(st.text(alphabet="xy01.<=>()+-*/^ andortuilwsmeb", max_size=40))
    @settings(deadline=None)
    def test_any_text_is_read_or_refused(self, text: str) -> None:
        with contextlib.suppress(FormulaError):  # any other exception fails the test
            robustness(parse(text, NAMES), NAMES, np.ones((2, 3)))

    def test_the_longest_allowed_text_can_be_evaluated(self) -> None:
        tree = parse("+".join("x" * 499) + "<1")
        assert robustness(tree, NAMES, np.ones((1, 3))) == -498.0
        assert columns(tree) == {"x"}

"""Formulas as text: what is read, what is refused and where, and back to text."""

import contextlib
import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.stl.horizon import check_horizon, horizon
from perfbound.orchestrator.mathematics.stl.parser import FormulaError, columns, parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.mathematics.stl.text import text as text_of
from perfbound.orchestrator.mathematics.stl.tree import (
    Absolute,
    Always,
    And,
    Arithmetic,
    Column,
    Comparison,
    Eventually,
    Expression,
    Fall,
    Formula,
    Function,
    Historically,
    Implies,
    Interval,
    Negative,
    Next,
    Not,
    Number,
    Once,
    Or,
    Previous,
    Rise,
    Since,
    Until,
    predicates,
)

NAMES = ("t", "x", "y")
X, Y = Column("x"), Column("y")
A, B, C = (Comparison("<", X, Number(1.0)), Comparison("<", Y, Number(1.0)), Comparison("<", X, Number(2.0)))


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
            ("abs(x - 1) < 0", Comparison("<", Absolute(Arithmetic("-", X, Number(1.0))), Number(0.0))),
        ],
    )
    def test_arithmetic(self, text: str, tree: Comparison) -> None:
        assert parse_formula(text) == tree

    @pytest.mark.parametrize(
        ("text", "tree"),
        [
            ("x<1 and y<1 or x<2", Or(And(A, B), C)),
            ("x<1 or y<1 and x<2", Or(A, And(B, C))),
            ("x<1 or y<1 or x<2", Or(Or(A, B), C)),
            ("x<1 implies y<1 implies x<2", Implies(A, Implies(B, C))),
            ("x<1 and y<1 implies x<2 or y<1", Implies(And(A, B), Or(C, B))),
            ("not x<1 and always y<1", And(Not(A), Always(B))),
            ("always (x<1 and y<1)", Always(And(A, B))),
            ("((x) < (1))", A),
            ("x<1 until y<1 and x<2", And(Until(A, B), C)),
            ("x<1 and y<1 until x<2", And(A, Until(B, C))),
            ("not x<1 until always[0,2] y<1", Until(Not(A), Always(B, Interval(0, 2)))),
            ("(x<1 until y<1) until x<2", Until(Until(A, B), C)),
            ("always[1,2] not eventually x<1", Always(Not(Eventually(A)), Interval(1, 2))),
        ],
    )
    def test_precedence_of_words(self, text: str, tree: Formula) -> None:
        assert parse_formula(text) == tree

    @pytest.mark.parametrize(
        ("text", "tree"),
        [
            ("always[0,15] x<1", Always(A, Interval(0, 15))),
            ("eventually [ .5 , 1e1 ] x<1", Eventually(A, Interval(0.5, 10))),
            ("always[2,inf) x<1", Always(A, Interval(2))),
            ("always[0,inf) x<1", Always(A)),
            ("always[0,5) x<1", Always(A, Interval(0, 5, high_open=True))),
            ("once (1, 5] x<1", Once(A, Interval(1, 5, low_open=True))),
            ("historically(0,inf) x<1", Historically(A, Interval(low_open=True))),
            ("x<1 since(0,5) y<1", Since(A, B, Interval(0, 5, True, True))),
            ("always (0 < x)", Always(Comparison("<", Number(0.0), X))),
            ("next rise(x<1)", Next(Rise(A))),
            ("x<1 until[0,0] y<1", Until(A, B, Interval(0, 0))),
            ("x<1 until_from[1,2] y<1", Until(A, B, Interval(1, 2), "paper")),
            ("x<1 until_from y<1", Until(A, B, reading="paper")),
        ],
    )
    def test_intervals(self, text: str, tree: Formula) -> None:
        assert parse_formula(text) == tree

    def test_the_example_of_the_issue(self) -> None:
        tree = parse_formula(
            "always[0,15] (abs(phi) <= 0.95 and (x - 2.5)^2 + (y - 2.5)^2 <= 9)", ("t", "x", "y", "phi")
        )
        assert columns(tree) == {"phi", "x", "y"}
        assert len(predicates(tree)) == 2

    @pytest.mark.parametrize(
        ("text", "position", "spelling"),
        [
            ("G[0,30] (x < 1)", 0, "always[0,30] (x < 1)"),
            ("G (x < 1)", 0, "always (x < 1)"),
            ("G_[0,2] x < 1", 0, "always[0,2] x < 1"),
            ("G x < 1 and y < 1", 0, "always x < 1 and y < 1"),
            ("F_[0,2] not x < 1", 0, "eventually[0,2] not x < 1"),
            ("x < 1 U[0,5] (y > 0)", 6, "x < 1 until[0,5] (y > 0)"),
            ("(x < 1) U (y > 0)", 8, "(x < 1) until (y > 0)"),
            ("always_[0,3] (alw_[0,1] x < 1)", 0, "always[0,3] (always[0,1] x < 1)"),
            ("G (x < 1 -> F[0,2] !(y > 0))", 0, "always (x < 1 implies eventually[0,2] not (y > 0))"),
            ("\u25a1[0,2] (x \u2264 1 \u2227 y < 1 || x > 2)", 0, "always [0,2] (x <= 1 and y < 1 or x > 2)"),
            ("x => 1", 2, "x >= 1"),
            ("always (x => 1 and y =< 2)", 10, "always (x >= 1 and y <= 2)"),
            ("x < 1 => y < 1", 6, "x < 1 implies y < 1"),
            ("x > = 1", 2, "x >= 1"),
            ("ALWAYS (x < 1 AND Not (y > 1))", 0, "always (x < 1 and not (y > 1))"),
            ("Eventually[0,2] x < 1 Or y < 1", 0, "eventually[0,2] x < 1 or y < 1"),
            ("x < 1 --> y < 1", 6, "x < 1 implies y < 1"),
            ("\u201calways (x < 1)\u201d", 0, "always (x < 1)"),
            ("always\u00a0(x < 1)", 6, "always (x < 1)"),
            ("x \u2212 1 < 2 \u00b7 y", 2, "x - 1 < 2 * y"),
            ("x**2 + y\u00b2 < 1", 1, "x^2 + y^2 < 1"),
            ("always (|x| < 1)", 8, "always (abs(x) < 1)"),
            ("always {x < 1}", 7, "always (x < 1)"),
            ("always[0:5] x < 1", 6, "always[0,5] x < 1"),
            ("always(0;5) x < 1", 6, "always(0,5) x < 1"),
            ("X x < 1 and Y (y > 0)", 0, "next x < 1 and previous (y > 0)"),
            ("H[0,2] x < 1 or O[1,2] y < 1", 0, "historically[0,2] x < 1 or once[1,2] y < 1"),
            ("x < 1 S[0,5] (y > 0)", 6, "x < 1 since[0,5] (y > 0)"),
            ("x < 1 since_[0:5] y > 0", 6, "x < 1 since[0,5] y > 0"),
            ("rose(x < 1) and fell(y < 1)", 0, "rise(x < 1) and fall(y < 1)"),
            ("ln(x) < 1", 0, "log(x) < 1"),
        ],
    )
    def test_the_spelling_of_other_tools_is_answered_by_this_one(self, text: str, position: int, spelling: str) -> None:
        with pytest.raises(FormulaError) as caught:
            parse_formula(text, NAMES)
        assert (caught.value.reason, caught.value.position) == (f"write `{spelling}`", position)
        parse_formula(spelling, NAMES)

    @pytest.mark.parametrize("text", ["always G < 1", "G - F > U", "(G) < 1 until F > 1", "abs(F) <= U and G < 1"])
    def test_a_column_may_have_the_name_of_an_operator_elsewhere(self, text: str) -> None:
        assert columns(parse_formula(text, ("G", "F", "U"))) <= {"G", "F", "U"}

    def test_before_a_phrase_such_a_name_is_the_operator(self) -> None:
        with pytest.raises(FormulaError, match=r"write `always\[0,1\] G < 1`"):
            parse_formula("G[0,1] G < 1", ("G",))
        with pytest.raises(FormulaError, match="a condition is needed here"):
            parse_formula("x < 1 and F", ("x", "F"))

    @pytest.mark.parametrize(
        ("text", "position", "reason"),
        [
            ("", 0, "not complete"),
            ("x <= ", 4, "not complete"),
            ("always (x <= 1", 14, r"'\)' expected"),
            ("x <= 1)", 6, "unexpected"),
            ("always x", 7, "compare it with"),
            ("x <= 1 and y", 11, "compare it with"),
            ("x until y <= 1", 0, "compare it with"),
            ("1 + (x <= 1) <= 2", 4, "number is needed"),
            ("(x <= 1) + 2 <= 2", 0, "number is needed"),
            ("x <= 1 until y <= 1 until x <= 1", 20, "`until` does not chain"),
            ("x == 1", 2, r"== compares whole numbers, and 'x' .*: write `abs\(x - 1\) <= 0.1` with your tolerance"),
            ("x + 1 != y", 6, r"!= compares .* write `abs\(x \+ 1 - y\) > 0.1`"),
            ("x <= 1 & y <= 1", 7, "write `x <= 1 and y <= 1`"),
            ("x <= 1 & y <= 1 or zz <= 1", 7, "write `x <= 1 and y <= 1 or zz <= 1`; there: unknown column 'zz'"),
            ("always (xx <= 1)", 8, "unknown column 'xx'; did you mean 'x'\\? known are t, x, y"),
            ("allways (x <= 1)", 0, "unknown function 'allways'; did you mean 'always'\\? there are abs, max"),
            ("alwyas[0,5] x <= 1", 0, "there is no operator 'alwyas'; did you mean 'always'\\?"),
            ("x <= 1 adn y <= 1", 7, "unexpected 'adn'; did you mean 'and'\\?"),
            ("x <= 1 # y", 7, "unexpected character '#'"),
            ("always[0 5] x <= 1", 9, "',' expected"),
            ("always[-1,5] x <= 1", 7, "a number of 0 or more"),
            ("always[0,x] x <= 1", 9, "a number of 0 or more"),
            ("always[inf,inf) x <= 1", 7, "a number of 0 or more"),
            ("always[5,2] x <= 1", 9, "needs a <= b"),
            ("always[0,5 x <= 1", 11, "unexpected 'x'; write 5 alone, in s"),
            ("always[0,5, x <= 1", 10, "an interval ends with"),
            ("always(5,5] x <= 1", 9, r"write \[a,a\]"),
            ("once[-1,0] x <= 1", 5, "0 or more expected; once, historically and since read the past"),
            ("rise x <= 1", 5, r"write rise\(condition\)"),
            ("rise(x) and x <= 1", 5, "a condition is needed"),
            ("max(x) <= 1", 0, r"two numbers or more: max\(x, y\)"),
            ("x <= 1 since y <= 1 since x <= 1", 20, "`since` does not chain"),
            ("log10(x) <= 1", 0, r"write log\(x\) / log\(10\)"),
            ("always[0,inf] x <= 1", 12, "without end is written"),
            ("abs(0,x) <= 1", 0, "abs has one number between its parentheses, not 2"),
            ("x <= 1 and[0,5] y <= 1", 10, "written right after always"),
            ("x <= inf", 5, "written right after always"),
            ("until", 0, "unexpected 'until'"),
            ("sinh(x) <= 1", 0, "unknown function 'sinh'; did you mean 'sin'"),
            ("abs x <= 1", 4, r"'\(' expected"),
            ("x <= 1 and zz <= 1", 11, "unknown column 'zz'; known are t, x, y"),
            ("x <= 1e999", 5, "too large"),
            ("x <= 2y", 6, r"unexpected 'y'; write `2 \* y`"),
            ("x < 1 y < 1", 6, r"unexpected 'y'; write `1 \* y`, or `and`"),
            ("always (x < 2 m)", 14, "unexpected 'm'; write 2 alone, in the unit of its column :"),
            ("always (x < 2m/s)", 13, "unexpected 'm'; write 2 alone"),
            ("x < 2 [m]", 6, "unexpected 'm'; write 2 alone"),
            ("x < 5 deg", 6, "write 5 alone, in the unit of its column; in rad it is 0.0872665"),
            ("x < 5\u00b0", 5, "write 5 alone, in the unit of its column; in rad it is 0.0872665"),
            ("x < 10%", 6, "unexpected '%'; write 10 alone, .*; as a share it is 0.1"),
            ("always[0,5 s] x < 1", 11, "unexpected 's'; write 5 alone, in s :"),
            ("G (x < 2 m)", 0, r"write `always \(x < 2 m\)`; there: unexpected 'm'; write 2 alone"),
            ("x < 1 and F - x < 1", 10, "unknown column 'F'"),
            ("x => 2 m", 2, "write `x >= 2 m`; there: unexpected 'm'"),
            ("x < 1,5", 4, "write 1.5 with a point"),
            ("x[0] < 1", 1, "a column has no index"),
            ("abs(x < 1)", 4, r"close abs\( \) before the comparison"),
            ("x = 1", 2, r"use <=, .* `==` of a discrete column, or abs\(a - b\) <= 0.1 with your tolerance"),
            ("x \u2260 1", 2, "write `x != 1`; there: != compares whole numbers"),
            ("norm(x) < 1", 0, r"unknown function 'norm'; write sqrt\(x\^2 \+ y\^2\); there are abs, max, min, sqrt"),
            ("((x < 1)", 8, r"'\)' expected, which closes the '\(' of character 1 :"),
            ("x < 1)", 5, r"no '\(' before it is open"),
            ("x <= 1 and\n  (y <= 2", 20, r"'\)' expected"),
            ("(" * 60 + "x", 41, "levels of nesting"),
            ("not " * 60 + "x <= 1", 164, "levels of nesting"),
            ("+".join("x" * 600), 1000, "more than 1000"),
        ],
    )
    def test_errors_point_at_the_place(self, text: str, position: int, reason: str) -> None:
        with pytest.raises(FormulaError, match=reason) as caught:
            parse_formula(text, NAMES)
        assert caught.value.position == position
        assert caught.value.reason in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1

    @pytest.mark.parametrize(
        ("name", "near"),
        [
            ("Tank.level", "did you mean 'tank_level'\\? known"),
            ("plant.Tank.level", "did you mean 'tank_level'\\? known"),
            ("Inner.flow", "did you mean 'pump_inner_flow'\\? known"),
            ("Pump.speed", "write _; known"),  # two columns end with it
            ("der(h)", "did you mean 'der_h'\\?"),
        ],
    )
    def test_a_name_of_an_fmu_is_answered_by_that_of_its_column(self, name: str, near: str) -> None:
        known = ("t", "tank_level", "pump_inner_flow", "a_speed", "b_speed", "der_h")
        with pytest.raises(FormulaError, match=near) as caught:
            parse_formula(f"always ({name} <= 1)", known)
        assert caught.value.position == 8

    @pytest.mark.parametrize(
        ("text", "line"),
        [
            (
                "always (abs(zz) <= 0.95)",
                "character 13: unknown column 'zz'; known are t, x, y : always (abs(>>>zz<<<) <= 0.95)",
            ),
            ("x <= 1 and ", "character 11: the formula is not complete : x <= 1 and>>>end<<<"),
            (
                "always (\n\tx <= 1 and\n\ty ? 2)",
                "line 3, character 4: unexpected character '?' : always (  x <= 1 and  y >>>?<<< 2)",
            ),
            (
                f"{'x + ' * 40}zz{' + x' * 40} <= 1",
                f"character 161: unknown column 'zz'; known are t, x, y : ...{'x + ' * 15}>>>zz<<<{' + x' * 15}...",
            ),
        ],
    )
    def test_the_place_is_marked_in_one_line(self, text: str, line: str) -> None:
        with pytest.raises(FormulaError) as caught:
            parse_formula(text, NAMES)
        assert str(caught.value) == line

    @pytest.mark.rest
    @given(st.text(alphabet="xy01.,<=>()[]+-*/^! andortuilwsmebfcepvxqhg_", max_size=40))
    @settings(deadline=None)
    def test_any_text_is_read_or_refused(self, text: str) -> None:
        samples = np.column_stack([np.arange(3.0), np.ones((3, 2))])
        with contextlib.suppress(FormulaError):  # any other exception fails the test
            tree = parse_formula(text, NAMES)
            robustness(tree, NAMES, samples)
            assert parse_formula(text_of(tree)) == tree

    def test_the_longest_allowed_text_can_be_evaluated(self) -> None:
        tree = parse_formula("+".join("x" * 499) + "<1")
        assert robustness(tree, NAMES, np.ones((1, 3))) == -498.0
        assert columns(tree) == {"x"}
        assert text_of(parse_formula(text_of(tree))) == text_of(tree)
        with pytest.raises(ValueError, match=r"`x \+ x .*\.\.\.` is nan"):
            robustness(tree, NAMES, np.full((1, 3), np.nan))
        many = parse_formula(" and ".join(["x<1"] * 250))
        check_horizon(many, 0.0)
        assert robustness(many, NAMES, np.ones((1, 3))) == 0.0

    def test_the_deepest_allowed_text_can_be_read(self) -> None:
        tree = parse_formula("(" * 39 + "always[0,0] x<1" + ")" * 39)
        assert tree == Always(A, Interval(0, 0))
        assert horizon(parse_formula("always[0,1] " * 39 + "x<1")) == 39


class TestTree:
    @pytest.mark.parametrize(
        "bounds", [(-1.0, 2.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.nan), (math.inf, math.inf)]
    )
    def test_intervals_are_checked(self, bounds: tuple[float, float]) -> None:
        with pytest.raises(ValueError, match="needs 0 <= low <= high"):
            Interval(*bounds)

    @pytest.mark.parametrize("value", [-1.0, -0.0, math.inf, math.nan])
    def test_numbers_are_checked(self, value: float) -> None:
        with pytest.raises(ValueError, match="finite and not negative"):
            Number(value)


def draw_expression(rng: random.Random, depth: int) -> Expression:
    if depth == 0 or rng.random() < 0.3:
        leaves: list[Expression] = [
            X,
            Y,
            Number(float(rng.randint(0, 9))),
            Number(rng.random() * 10.0 ** rng.randint(-9, 20)),
        ]
        return rng.choice(leaves)
    left, right = draw_expression(rng, depth - 1), draw_expression(rng, depth - 1)
    operators: list[Any] = ["+", "-", "*", "/", "^"]
    options: list[Expression] = [Negative(left), Absolute(left), Function("max", (left, right, left))]
    options += [Function(name, (left,)) for name in ("sqrt", "sin", "cos", "tan", "exp", "log")]
    options += [Arithmetic(sign, left, right) for sign in operators]
    return rng.choice(options)


def draw_formula(rng: random.Random, depth: int) -> Formula:
    if depth == 0:
        return Comparison(rng.choice(["<=", ">=", "<", ">"]), draw_expression(rng, 4), draw_expression(rng, 2))
    left, right = draw_formula(rng, rng.randrange(depth)), draw_formula(rng, rng.randrange(depth))
    low = rng.choice([0.0, 1.0, rng.random()])
    ends = [Interval(low, 1e6, *rng.choices([True, False], k=2)), Interval(low, low_open=True)]
    interval = rng.choice([Interval(), Interval(low), Interval(low, low + rng.random() * 1e-6), *ends])
    options: list[Formula] = [
        Not(left),
        Always(left, interval),
        Eventually(left, interval),
        And(left, right),
        Or(left, right),
        Implies(left, right),
        Until(left, right, interval),
        Until(left, right, interval, "paper"),
        Once(left, interval),
        Historically(left, interval),
        Since(left, right, interval),
        *(kind(left) for kind in (Next, Previous, Rise, Fall)),
    ]
    return rng.choice(options)


class TestText:
    @pytest.mark.rest
    def test_round_trip(self) -> None:
        rng = random.Random(1)
        for _ in range(1000):
            tree = draw_formula(rng, rng.randint(0, 6))
            assert parse_formula(text_of(tree), NAMES) == tree, text_of(tree)

    @pytest.mark.parametrize(
        "text",
        [
            "always[0,15] (abs(phi) <= 0.95 and (x - 2.5)^2 + (y - 2.5)^2 <= 9)",
            "x <= 1 implies eventually[0.5,inf) not y > 1e-09",
            "(x <= 1 until[0,3] y > 2) until_from -x^-2 / (y * 3) >= x - (y - 1)",
            "historically[0,2) x < 1 since(1,3] next (y < 1 or previous x > 2) and rise(max(x, y, 1) < sqrt(y))",
            "((x <= 1 implies y <= 1) implies (x <= 1 or y <= 2) and x < 3) or (x <= 1 or y <= 1)",
        ],
    )
    def test_no_more_parentheses_than_needed(self, text: str) -> None:
        assert text_of(parse_formula(text)) == text


@pytest.mark.parametrize("known", [None, ("t", "x", "y")])
@pytest.mark.parametrize("text", ["release x >= 0", "always release x >= 0", "x >= 0 and (release x >= 1)"])
def test_an_operator_that_does_not_exist_is_named(text: str, known: tuple[str, ...] | None) -> None:
    with pytest.raises(FormulaError, match=r"there is no operator 'release'; .*there are always, eventually") as caught:
        parse_formula(text, known)
    assert caught.value.position == text.index("release")


def test_a_misspelled_operator_names_the_nearest() -> None:
    with pytest.raises(FormulaError, match=r"there is no operator 'alway'; nearest: always; there are always"):
        parse_formula("alway x >= 0", ("t", "x"))


UNITS = {"t": "s", "x": "m", "y": "m", "gear": "discrete", "mode": "discrete"}


class TestDiscrete:
    @pytest.mark.parametrize(
        "text", ["gear == 3", "not gear != mode", "abs(gear - mode) == 1", "-gear + 2 * mode == max(gear, 3, mode)"]
    )
    def test_whole_numbers_can_be_compared(self, text: str) -> None:
        assert text_of(parse_formula(text, UNITS)) == text

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("gear == 2.5", "and 2.5 is none"),
            ("gear == x", "'x' is no column with the unit \"discrete\""),
            ("gear / 2 == 1", "what / gives may be none"),
            ("sqrt(gear) != 1", "what sqrt gives may be none"),
        ],
    )
    def test_other_numbers_cannot(self, text: str, reason: str) -> None:
        with pytest.raises(FormulaError, match=reason):
            parse_formula(text, UNITS)

    def test_without_columns_every_one_may_be_discrete(self) -> None:
        parse_formula("x == 1")

    def test_a_column_with_the_name_of_a_word_is_named(self) -> None:
        with pytest.raises(FormulaError, match="'max' is a word of specifications, and names no column") as caught:
            parse_formula("x <= 1 and max <= 1", ("x", "max"))
        assert caught.value.position == 11


@pytest.mark.parametrize(
    ("chain", "meaning"),
    [
        ("1 <= x < 2", "1 <= x and x < 2"),
        ("0 < x <= y < 3 until y > 1", "(0 < x and x <= y and y < 3) until y > 1"),
        ("always not 0 <= x < 1", "always not (0 <= x and x < 1)"),
        ("gear == mode == 1", "gear == mode and mode == 1"),
    ],
)
def test_a_chain_of_comparisons_is_their_conjunction(chain: str, meaning: str) -> None:
    assert parse_formula(chain, UNITS) == parse_formula(meaning, UNITS)

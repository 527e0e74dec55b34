"""STL formulas: text to a frozen tree, by recursive descent. Implements eq. (spec) of [ARA].

Grammar, loosest first (words are lower case; `implies` and `^` group to the right, `until` and the comparisons do not
chain, the rest groups to the left):

    formula     = disjunction [ "implies" formula ]
    disjunction = conjunction { "or" conjunction }
    conjunction = until { "and" until }
    until       = unary [ ( "until" | "until_from" ) [ interval ] unary ]
    unary       = ( "not" | ( "always" | "eventually" ) [ interval ] ) unary | comparison
    interval    = "[" number "," ( number "]" | "inf" ")" )
    comparison  = sum [ ( "<=" | ">=" | "<" | ">" ) sum ]
    sum         = product { ( "+" | "-" ) product }
    product     = sign { ( "*" | "/" ) sign }
    sign        = "-" sign | power
    power       = atom [ "^" sign ]
    atom        = number | column | "abs" "(" sum ")" | "(" formula ")"

One ladder serves formulas and arithmetic, so that "(" needs no look-ahead; every operator checks its operands' kind.
"""

import math
from collections.abc import Callable, Collection
from typing import cast

from .errors import FormulaError
from .tokens import Token, tokens
from .tree import (
    REST,
    Absolute,
    Always,
    And,
    Arithmetic,
    ArithmeticOperator,
    Column,
    Comparator,
    Comparison,
    Eventually,
    Expression,
    Formula,
    Implies,
    Interval,
    Negative,
    Node,
    Not,
    Number,
    Or,
    Reading,
    Until,
    columns,
)

__all__ = ["Formula", "FormulaError", "columns", "parse"]

MAX_NESTING = 40
"""Deeper text would exhaust Python's stack; no specification written by a person comes near."""

_UNTIL: dict[str, Reading] = {"until": "standard", "until_from": "paper"}
_RESERVED = {"not", "always", "eventually", *_UNTIL, "and", "or", "implies", "abs", "inf"}
_COMPARATORS = {"<=", ">=", "<", ">"}


def parse(text: str, known: Collection[str] | None = None) -> Formula:
    """Return the tree of the formula `text`; with `known`, refuse a column that is not among them.

    Raises:
        FormulaError: the text is no formula, or names an unknown column; the message marks the place.

    >>> from perfbound.orchestrator.mathematics.stl.text import text as shown
    >>> shown(parse("always [0, 15] ((abs(phi) <= 0.95))"))
    'always[0,15] abs(phi) <= 0.95'

    """
    return _Parser(text, known).parse()


class _Parser:
    def __init__(self, text: str, known: Collection[str] | None) -> None:
        self._text, self._known = text, known
        self._tokens = tokens(text)
        self._next = 0
        self._depth = 0

    def parse(self) -> Formula:
        start = self._token
        tree = self._formula()
        if self._token.kind != "end":
            raise self._error(self._too_much())
        return self._as_formula(tree, start)

    @property
    def _token(self) -> Token:
        return self._tokens[self._next]

    def _take(self, *texts: str) -> str | None:
        """Consume the next token if it is one of `texts`."""
        token = self._token
        if token.kind in {"sign", "word"} and token.text in texts:
            self._next += 1
            return token.text
        return None

    def _error(self, reason: str, token: Token | None = None) -> FormulaError:
        place = token or self._token
        return FormulaError(reason, self._text, place.position, len(place.text))

    def _too_much(self) -> str:
        """Say why the text cannot go on with the next token."""
        if self._token.text in _UNTIL:
            return "`until` does not chain: put one of the two into parentheses"
        if self._token.text in _COMPARATORS:
            return "comparisons do not chain: write `a <= b and b <= c`"
        return self._unexpected()

    def _unexpected(self) -> str:
        if self._token.text in {",", "[", "]", "inf"}:
            return "an interval [a,b] or [a,inf) stands right after always, eventually or until"
        if self._token.kind == "end":
            return "the formula is not complete"
        return f"unexpected {self._token.text!r}"

    def _as_formula(self, node: Node, start: Token) -> Formula:
        if isinstance(node, Expression):
            raise self._error("a number stands where a condition is needed: compare it with <=, >=, < or >", start)
        return node

    def _as_expression(self, node: Node, start: Token) -> Expression:
        if not isinstance(node, Expression):
            raise self._error("a condition stands where a number is needed", start)
        return node

    def _formula(self) -> Node:
        start = self._token
        left = self._disjunction()
        if not self._take("implies"):
            return left
        right_start = self._token
        self._deeper()
        right = self._as_formula(self._formula(), right_start)
        self._depth -= 1
        return Implies(self._as_formula(left, start), right)

    def _disjunction(self) -> Node:
        start = self._token
        node = self._conjunction()
        while self._take("or"):
            right_start = self._token
            node = Or(self._as_formula(node, start), self._as_formula(self._conjunction(), right_start))
        return node

    def _conjunction(self) -> Node:
        start = self._token
        node = self._until()
        while self._take("and"):
            right_start = self._token
            node = And(self._as_formula(node, start), self._as_formula(self._until(), right_start))
        return node

    def _until(self) -> Node:
        start = self._token
        left = self._unary()
        word = self._take(*_UNTIL)
        if word is None:
            return left
        interval = self._interval()
        right_start = self._token
        right = self._as_formula(self._unary(), right_start)
        return Until(self._as_formula(left, start), right, interval, _UNTIL[word])

    def _unary(self) -> Node:
        word = self._take("not", "always", "eventually")
        if word is None:
            return self._comparison()
        interval = REST if word == "not" else self._interval()
        start = self._token
        self._deeper()
        node = self._as_formula(self._unary(), start)
        self._depth -= 1
        if word == "not":
            return Not(node)
        return Always(node, interval) if word == "always" else Eventually(node, interval)

    def _interval(self) -> Interval:
        if not self._take("["):
            return REST
        low = self._seconds()
        if not self._take(","):
            raise self._error("an interval is [a,b] or [a,inf): ',' expected")
        if self._take("inf"):
            self._close(")", "an interval without end is written [a,inf)")
            return Interval(low)
        start = self._token
        high = self._seconds()
        if high < low:
            raise self._error("an interval [a,b] needs a <= b", start)
        self._close("]", "an interval [a,b] includes both ends: ']' expected")
        return Interval(low, high)

    def _seconds(self) -> float:
        if self._token.kind != "number":
            raise self._error("an interval is [a,b] or [a,inf) with seconds from now: a number of 0 or more expected")
        return self._number().value

    def _close(self, sign: str, reason: str) -> None:
        if not self._take(sign):
            raise self._error(reason)

    def _comparison(self) -> Node:
        start = self._token
        left = self._sum()
        operator = self._take(*_COMPARATORS)
        if operator is None:
            return left
        right_start = self._token
        right = self._as_expression(self._sum(), right_start)
        return Comparison(cast(Comparator, operator), self._as_expression(left, start), right)

    def _sum(self) -> Node:
        start = self._token
        node = self._product()
        while operator := self._take("+", "-"):
            node = self._arithmetic(operator, node, start, self._product)
        return node

    def _product(self) -> Node:
        start = self._token
        node = self._sign()
        while operator := self._take("*", "/"):
            node = self._arithmetic(operator, node, start, self._sign)
        return node

    def _sign(self) -> Node:
        if not self._take("-"):
            return self._power()
        start = self._token
        self._deeper()
        node = self._as_expression(self._sign(), start)
        self._depth -= 1
        return Negative(node)

    def _power(self) -> Node:
        start = self._token
        node = self._atom()
        return self._arithmetic("^", node, start, self._sign) if self._take("^") else node

    def _arithmetic(self, operator: str, left: Node, start: Token, parse_right: Callable[[], Node]) -> Arithmetic:
        right_start = self._token
        self._deeper()
        right = self._as_expression(parse_right(), right_start)
        self._depth -= 1
        return Arithmetic(cast(ArithmeticOperator, operator), self._as_expression(left, start), right)

    def _atom(self) -> Node:
        token = self._token
        if token.kind == "number":
            return self._number()
        if self._take("abs"):
            return Absolute(self._as_expression(self._parenthesis(), token))
        if token.text == "(":
            return self._parenthesis()
        if token.kind == "word" and token.text not in _RESERVED:
            return self._column()
        raise self._error(self._unexpected())

    def _number(self) -> Number:
        value = float(self._token.text)
        if not math.isfinite(value):
            raise self._error("the number is too large")
        self._next += 1
        return Number(value)

    def _column(self) -> Column:
        name = self._token.text
        if self._tokens[self._next + 1].text == "(":
            raise self._error(f"unknown function {name!r}; the only function is abs")
        if self._known is not None and name not in self._known:
            raise self._error(f"unknown column {name!r}; known are {', '.join(self._known)}")
        self._next += 1
        return Column(name)

    def _parenthesis(self) -> Node:
        if not self._take("("):
            raise self._error("'(' expected")
        self._deeper()
        node = self._formula()
        self._depth -= 1
        if not self._take(")"):
            raise self._error(self._too_much() if self._token.kind != "end" else "')' expected")
        return node

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise self._error(f"more than {MAX_NESTING} levels of nesting")

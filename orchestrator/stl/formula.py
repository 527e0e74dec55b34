"""STL formulas: text to a frozen tree, by recursive descent.

Grammar, loosest first (words are lower case; `implies` and `^` group to the right, the rest to the left):

    formula     = disjunction [ "implies" formula ]
    disjunction = conjunction { "or" conjunction }
    conjunction = unary { "and" unary }
    unary       = ( "not" | "always" | "eventually" ) unary | comparison
    comparison  = sum [ ( "<=" | ">=" | "<" | ">" ) sum ]
    sum         = product { ( "+" | "-" ) product }
    product     = sign { ( "*" | "/" ) sign }
    sign        = "-" sign | power
    power       = atom [ "^" sign ]
    atom        = number | column | "abs" "(" sum ")" | "(" formula ")"

One ladder serves formulas and arithmetic, so that "(" needs no look-ahead; every operator checks its operands' kind.
"""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import cast

from orchestrator.stl.tree import (
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
    Negative,
    Node,
    Not,
    Number,
    Or,
    columns,
)

__all__ = ["Formula", "FormulaError", "columns", "parse"]

MAX_NESTING = 40
MAX_TOKENS = 1000
"""Deeper or longer text would exhaust Python's stack; no specification written by a person comes near."""

_TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
          |(?P<word>[A-Za-z_]\w*)
          |(?P<sign><=|>=|[-+*/^()<>]))""",
    re.ASCII | re.VERBOSE,
)
_UNARY: dict[str, type[Not | Always | Eventually]] = {"not": Not, "always": Always, "eventually": Eventually}
_RESERVED = {*_UNARY, "and", "or", "implies", "abs", "until"}
_COMPARATORS = {"<=", ">=", "<", ">"}
_LATER = "{} comes in a later version: use unbounded always and eventually"


class FormulaError(ValueError):
    """The text of a specification cannot be read; the message shows where."""

    def __init__(self, reason: str, text: str, position: int) -> None:
        line = text.rfind("\n", 0, position) + 1
        shown = text[line:].split("\n", 1)[0].replace("\t", " ")
        super().__init__(f"specification: {reason}\n  {shown}\n  {' ' * (position - line)}^")
        self.position = position


def parse(text: str, known: Collection[str] | None = None) -> Formula:
    """Return the tree of the formula `text`; with `known`, refuse a column that is not among them.

    Raises:
        FormulaError: the text is no formula, or names an unknown column; a caret points at the place.

    >>> parse("always (abs(phi) <= 0.95)")
    Always(operand=Comparison(operator='<=', left=Absolute(operand=Column(name='phi')), right=Number(value=0.95)))

    """
    return _Parser(text, known).parse()


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str  # number, word, sign, end
    text: str
    position: int


def _tokens(text: str) -> list[_Token]:
    tokens: list[_Token] = []
    position, end = 0, len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            start = position + len(text[position:]) - len(text[position:].lstrip())
            raise FormulaError(_refusal(text[start]), text, start)
        kind = match.lastgroup
        tokens.append(_Token(kind, match[kind], match.start(kind)))
        position = match.end()
        if len(tokens) > MAX_TOKENS:
            raise FormulaError(f"more than {MAX_TOKENS} words and signs", text, match.start(kind))
    return [*tokens, _Token("end", "the end of the text", end)]


def _refusal(character: str) -> str:
    if character == "[":
        return _LATER.format("a time interval")
    if character in "=!":
        return "equality has no robustness: use <=, >=, < or >"
    if character in "&|":
        return "write `and`, `or`, `implies`"
    return f"unexpected character {character!r}"


class _Parser:
    def __init__(self, text: str, known: Collection[str] | None) -> None:
        self._text, self._known = text, known
        self._tokens = _tokens(text)
        self._next = 0
        self._depth = 0

    def parse(self) -> Formula:
        start = self._token
        tree = self._formula()
        if self._token.kind != "end":
            raise self._error(self._unexpected())
        return self._as_formula(tree, start)

    @property
    def _token(self) -> _Token:
        return self._tokens[self._next]

    def _take(self, *texts: str) -> str | None:
        """Consume the next token if it is one of `texts`."""
        token = self._token
        if token.kind in {"sign", "word"} and token.text in texts:
            self._next += 1
            return token.text
        return None

    def _error(self, reason: str, token: _Token | None = None) -> FormulaError:
        return FormulaError(reason, self._text, (token or self._token).position)

    def _unexpected(self) -> str:
        if self._token.text == "until":
            return _LATER.format("`until`")
        if self._token.text in _COMPARATORS:
            return "comparisons do not chain: write `a <= b and b <= c`"
        if self._token.kind == "end":
            return "the formula is not complete"
        return f"unexpected {self._token.text!r}"

    def _as_formula(self, node: Node, start: _Token) -> Formula:
        if isinstance(node, Expression):
            raise self._error("a number stands where a condition is needed: compare it with <=, >=, < or >", start)
        return node

    def _as_expression(self, node: Node, start: _Token) -> Expression:
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
        node = self._unary()
        while self._take("and"):
            right_start = self._token
            node = And(self._as_formula(node, start), self._as_formula(self._unary(), right_start))
        return node

    def _unary(self) -> Node:
        word = self._take(*_UNARY)
        if word is None:
            return self._comparison()
        start = self._token
        self._deeper()
        node = self._as_formula(self._unary(), start)
        self._depth -= 1
        return _UNARY[word](node)

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

    def _arithmetic(self, operator: str, left: Node, start: _Token, parse_right: Callable[[], Node]) -> Arithmetic:
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
            raise self._error(self._unexpected() if self._token.kind != "end" else "')' expected")
        return node

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise self._error(f"more than {MAX_NESTING} levels of nesting")

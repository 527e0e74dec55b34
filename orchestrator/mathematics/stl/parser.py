"""Recursive-descent parser of STL formulas: `tokens` has its input, `tree` its output.
Implements eq. (spec) of [ARA].

Grammar, loosest first (words are lower case; `implies` and `^` group to the right, `until` and `since` do not chain,
the rest groups to the left; `a < b < c` is `a < b and b < c`):

    formula     = disjunction [ "implies" formula ]
    disjunction = conjunction { "or" conjunction }
    conjunction = until { "and" until }
    until       = unary [ ( "until" | "until_from" | "since" ) [ interval ] unary ]
    unary       = ( "not" | "next" | "previous" | over [ interval ] ) unary | comparison
    over        = "always" | "eventually" | "historically" | "once"
    interval    = ( "[" | "(" ) number "," ( number ( "]" | ")" ) | "inf" ")" )
    comparison  = sum { ( "<=" | ">=" | "<" | ">" | "==" | "!=" ) sum }
    sum         = product { ( "+" | "-" ) product }
    product     = sign { ( "*" | "/" ) sign }
    sign        = "-" sign | power
    power       = atom [ "^" sign ]
    atom        = number | column | function "(" sum { "," sum } ")" | ( "rise" | "fall" ) "(" formula ")"
                | "(" formula ")"

One ladder serves formulas and arithmetic, so that "(" needs no look-ahead; every operator checks its operands' kind.
"""

import math
from collections.abc import Callable, Collection, Mapping
from typing import cast

from ....schemas.values import DISCRETE, FORMULA_FUNCTIONS, FORMULA_WORDS
from . import hints
from .cursor import Cursor
from .errors import FormulaError
from .shorthand import spelled_out
from .tokens import FormulaToken
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
    Fall,
    Formula,
    Function,
    FunctionName,
    Historically,
    Implies,
    Interval,
    Negative,
    Next,
    Node,
    Not,
    Number,
    Once,
    Or,
    Previous,
    Reading,
    Rise,
    Since,
    Until,
    columns,
)

__all__ = ["Formula", "FormulaError", "columns", "parse_formula"]

_UNTIL: dict[str, Reading] = {"until": "standard", "until_from": "paper"}
_OVER: dict[str, Callable[[Formula, Interval], Formula]] = {
    "always": Always,
    "eventually": Eventually,
    "historically": Historically,
    "once": Once,
}
_PLAIN: dict[str, Callable[[Formula], Formula]] = {"not": Not, "next": Next, "previous": Previous}
_EDGES: dict[str, Callable[[Formula], Formula]] = {"rise": Rise, "fall": Fall}


def parse_formula(text: str, known: Collection[str] | None = None) -> Formula:
    """Return the tree of the formula `text`; with `known`, refuse a column that is not among them.

    `known` may have the unit of each column: those that are discrete can be compared with == and !=.

    Raises:
        FormulaError: the text is no formula, or names an unknown column; the message marks the place.

    >>> from perfbound.orchestrator.mathematics.stl.text import text as written
    >>> written(parse_formula("always [0, 15] ((abs(phi) <= 0.95))"))
    'always[0,15] abs(phi) <= 0.95'

    """
    try:
        return _parsed(text, known)
    except FormulaError as error:
        if clash := hints.clash(text, known or ()):
            reason = f"{clash.text!r} is a word of specifications, and names no column; rename it"
            raise FormulaError(reason, text, clash.position, len(clash.text)) from None
        raise _spelled_error(error, text, known) from None


def _spelled_error(error: FormulaError, text: str, known: Collection[str] | None) -> FormulaError:
    """Return the error of a text: with its spelling here, if it is a formula of other tools."""
    found, unread = error, math.inf
    for spelling in spelled_out(text, known):
        reason, length = f"write `{spelling.text}`", spelling.length
        try:
            _parsed(spelling.text, known)
        except FormulaError as further:
            left = len(spelling.text) - (further.position or 0)
            # The first fault may be another one, and another reading may be one of more of the text.
            if left <= unread and 0 <= (error.position or 0) - spelling.position < length:
                unread, reason = left, f"{reason}; there: {further.reason}"
                found = FormulaError(reason, text, spelling.position, length)
        else:
            return FormulaError(reason, text, spelling.position, length)
    return found


def _parsed(text: str, known: Collection[str] | None) -> Formula:
    cursor = Cursor(text)
    start = cursor.token
    tree = _Grammar(cursor, known).formula()
    if cursor.token.kind != "end":
        raise cursor.error(hints.surplus(cursor.token))
    return _as_formula(cursor, tree, start)


class _Grammar:
    """The rules that call one another; each moves past its phrase and returns its tree.

    A left operand is checked late, at the token that it starts with: only the operator after it shows what it must be.
    """

    def __init__(self, cursor: Cursor, known: Collection[str] | None) -> None:
        self._cursor, self._known = cursor, known
        self._functions = 0  # around the next token

    def formula(self) -> Node:
        start = self._cursor.token
        left = self._disjunction()
        if not self._cursor.take("implies"):
            return left
        with self._cursor.nested():
            right = _condition_phrase(self._cursor, self.formula)
        return Implies(_as_formula(self._cursor, left, start), right)

    def _disjunction(self) -> Node:
        start = self._cursor.token
        node = self._conjunction()
        while self._cursor.take("or"):
            left = _as_formula(self._cursor, node, start)
            node = Or(left, _condition_phrase(self._cursor, self._conjunction))
        return node

    def _conjunction(self) -> Node:
        start = self._cursor.token
        node = self._until()
        while self._cursor.take("and"):
            left = _as_formula(self._cursor, node, start)
            node = And(left, _condition_phrase(self._cursor, self._until))
        return node

    def _until(self) -> Node:
        start = self._cursor.token
        left = self._unary()
        word = self._cursor.take(*hints.UNTIL)
        if word is None:
            return left
        interval = _interval(self._cursor)
        right = _condition_phrase(self._cursor, self._unary)
        condition = _as_formula(self._cursor, left, start)
        if word == "since":
            return Since(condition, right, interval)
        return Until(condition, right, interval, _UNTIL[word])

    def _unary(self) -> Node:
        word = self._cursor.take(*_PLAIN, *_OVER)
        if word is None:
            return self._comparison()
        interval = _interval(self._cursor) if word in _OVER else REST
        with self._cursor.nested():
            node = _condition_phrase(self._cursor, self._unary)
        return _OVER[word](node, interval) if word in _OVER else _PLAIN[word](node)

    def _comparison(self) -> Node:
        start = self._cursor.token
        left = self._sum()
        chain: Formula | None = None
        while operator := self._cursor.take(*hints.COMPARATORS):
            sign = self._cursor.before
            smaller = _as_expression(self._cursor, left, start)
            left = larger = _numeric_phrase(self._cursor, self._sum)
            one = Comparison(cast(Comparator, operator), smaller, larger)
            if reason := hints.equality(one, self._discrete):
                raise self._cursor.error(reason, sign)
            chain = one if chain is None else And(chain, one)
        return left if chain is None else chain

    @property
    def _discrete(self) -> Collection[str] | None:
        """The columns of whole numbers; None if no column is known."""
        if self._known is None:
            return None
        units = self._known if isinstance(self._known, Mapping) else {}
        return {name for name, unit in units.items() if unit == DISCRETE}

    def _sum(self) -> Node:
        start = self._cursor.token
        node = self._product()
        while operator := self._cursor.take("+", "-"):
            node = self._arithmetic(operator, node, start, self._product)
        return node

    def _product(self) -> Node:
        start = self._cursor.token
        node = self._sign()
        while operator := self._cursor.take("*", "/"):
            node = self._arithmetic(operator, node, start, self._sign)
        return node

    def _sign(self) -> Node:
        if not self._cursor.take("-"):
            return self._power()
        with self._cursor.nested():
            return Negative(_numeric_phrase(self._cursor, self._sign))

    def _power(self) -> Node:
        start = self._cursor.token
        node = self._atom()
        return self._arithmetic("^", node, start, self._sign) if self._cursor.take("^") else node

    def _arithmetic(self, operator: str, left: Node, start: FormulaToken, right: Callable[[], Node]) -> Arithmetic:
        with self._cursor.nested():
            operand = _numeric_phrase(self._cursor, right)
        return Arithmetic(cast(ArithmeticOperator, operator), _as_expression(self._cursor, left, start), operand)

    def _atom(self) -> Node:
        token = self._cursor.token
        if token.kind == "number":
            number = _literal(self._cursor, self._known)
            # Between the parentheses of a function a comma is none of a number.
            if not self._functions and (reason := hints.decimal(token, *self._cursor.following)):
                raise self._cursor.error(reason, token)
            return number
        if token.text == "(":
            return self._parentheses()[0][0]
        if token.kind == "word" and token.text not in FORMULA_WORDS:
            return _column(self._cursor, self._known)
        if word := self._cursor.take(*_EDGES):
            ((node, start),) = self._parentheses(f"write {word}(condition)")
            return _EDGES[word](_as_formula(self._cursor, node, start))
        if name := self._cursor.take(*FORMULA_FUNCTIONS):
            return self._function(name, token)
        raise self._cursor.error(hints.unexpected(token))

    def _function(self, name: str, token: FormulaToken) -> Expression:
        self._functions += 1
        after = self._cursor.token
        found = self._parentheses(f"write {name}({after.text if after.kind == 'word' else 'x'})", several=True)
        self._functions -= 1
        remedy = f"; close {name}( ) before the comparison"
        arguments = tuple(_as_expression(self._cursor, node, start, remedy) for node, start in found)
        if reason := hints.arguments(name, len(arguments)):
            raise self._cursor.error(reason, token)
        return Absolute(arguments[0]) if name == "abs" else Function(cast(FunctionName, name), arguments)

    def _parentheses(self, remedy: str = "", *, several: bool = False) -> list[tuple[Node, FormulaToken]]:
        """Return the phrases between parentheses, with the token that each starts with."""
        opened = self._cursor.token
        if not self._cursor.take("("):
            raise self._cursor.error(f"'(' expected; {remedy}")
        found: list[tuple[Node, FormulaToken]] = []
        with self._cursor.nested():
            while not found or (several and self._cursor.take(",")):
                start = self._cursor.token
                found.append((self.formula(), start))
        if not self._cursor.take(")"):
            token = self._cursor.token
            if token.kind != "end":
                raise self._cursor.error(hints.surplus(token))
            raise self._cursor.error(f"')' expected, which closes the '(' of {self._cursor.place(opened)}")
        return found


def _condition_phrase(cursor: Cursor, rule: Callable[[], Node]) -> Formula:
    """Return the phrase of a rule, which must be a condition."""
    start = cursor.token
    return _as_formula(cursor, rule(), start)


def _numeric_phrase(cursor: Cursor, rule: Callable[[], Node]) -> Expression:
    """Return the phrase of a rule, which must be a number."""
    start = cursor.token
    return _as_expression(cursor, rule(), start)


def _as_formula(cursor: Cursor, node: Node, start: FormulaToken) -> Formula:
    if isinstance(node, Expression):
        raise cursor.error("a condition is needed here, not a number: compare it with <=, >=, < or >", start)
    return node


def _as_expression(cursor: Cursor, node: Node, start: FormulaToken, remedy: str = "") -> Expression:
    if not isinstance(node, Expression):
        raise cursor.error(f"a number is needed here, not a condition{remedy}", start)
    return node


def _interval(cursor: Cursor) -> Interval:
    # A number and a comma behind "(" are no condition in parentheses.
    opens = cursor.token.text == "(" and cursor.ahead(1).kind == "number" and cursor.ahead(2).text == ","
    if not (opens or cursor.token.text == "["):
        return REST
    cursor.advance()
    low = _seconds(cursor)
    if not cursor.take(","):
        raise cursor.error("an interval is [a,b] or [a,inf): ',' expected")
    if cursor.take("inf"):
        if not cursor.take(")"):
            raise cursor.error("an interval without end is written [a,inf)")
        return Interval(low, low_open=opens)
    start = cursor.token
    high = _seconds(cursor)
    if high < low:
        raise cursor.error("an interval [a,b] needs a <= b", start)
    closed = cursor.take("]", ")")
    if closed is None:
        raise cursor.error("an interval ends with ], where its end belongs to it, or with ): one of them expected")
    if high == low and (opens or closed == ")"):
        raise cursor.error("no moment is in this interval: write [a,a] for one moment", start)
    return Interval(low, high, opens, closed == ")")


def _seconds(cursor: Cursor) -> float:
    if cursor.token.kind != "number":
        past = "; once, historically and since read the past" if cursor.token.text == "-" else ""
        raise cursor.error(f"an interval is [a,b] or [a,inf) with seconds: a number of 0 or more expected{past}")
    return _literal(cursor, None, "s").value


def _literal(cursor: Cursor, known: Collection[str] | None, unit: str = "the unit of its column") -> Number:
    token = cursor.token
    value = float(token.text)
    if not math.isfinite(value):  # 1e999 has the form of a number
        raise cursor.error("the number is too large")
    cursor.advance()
    if reason := hints.unit(token, *cursor.following, known, unit):
        raise cursor.error(reason)
    return Number(value)


def _column(cursor: Cursor, known: Collection[str] | None) -> Column:
    name = cursor.token.text
    is_column = known is not None and name in known
    cursor.advance()
    after, further = cursor.following
    # Behind a column comes an operator: what stands before a phrase of its own is one that does not exist.
    reason = None
    if after.text == "(":
        reason = hints.function(name, further.text, known)
    elif not is_column and after.kind == "word" and after.text not in hints.BETWEEN:
        reason = hints.no_operator(name)
    elif known is not None and not is_column:
        reason = hints.unknown(name, after, known)
    if reason:
        raise cursor.error(reason, cursor.before)
    return Column(name)

"""Words, numbers and signs of a formula's text."""

import re
from dataclasses import dataclass
from typing import Literal, cast

from .errors import FormulaError

__all__ = ["MAX_TOKENS", "FormulaToken", "tokens"]

MAX_TOKENS = 1000
"""Longer text would exhaust Python's stack; no real specification comes near."""

Kind = Literal["number", "word", "sign", "end"]

# Names with dots, and signs of units, are words that no formula has: their messages need what stands beside them.
_TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
          |(?P<word>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*|%|\u00b0)
          |(?P<sign><=|>=|==|!=|[-+*/^()<>,]|\[|\]))""",
    re.ASCII | re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class FormulaToken:
    """A word, number or sign, or the end of the text, and the number of characters before it."""

    kind: Kind
    text: str
    position: int


def tokens(text: str) -> list[FormulaToken]:
    """Return the tokens of `text`; the last one is its end.

    Raises:
        FormulaError: a character that no formula has, or more than `MAX_TOKENS` tokens.

    """
    found: list[FormulaToken] = []
    position, end = 0, len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            start = position + len(text[position:]) - len(text[position:].lstrip())
            raise FormulaError(_bad_character(text[start]), text, start)
        kind = cast(Kind, match.lastgroup)
        found.append(FormulaToken(kind, match[kind], match.start(kind)))
        position = match.end()
        if len(found) > MAX_TOKENS:
            raise FormulaError(f"more than {MAX_TOKENS} words and signs", text, match.start(kind))
    return [*found, FormulaToken("end", "", end)]


def _bad_character(character: str) -> str:
    if character == "=":
        return "use <=, >=, < or >; `==` of a discrete column, or abs(a - b) <= 0.1 with your tolerance for a = b"
    if character in "&|":
        return "write `and`, `or`, `implies`"
    return f"unexpected character {character!r}"

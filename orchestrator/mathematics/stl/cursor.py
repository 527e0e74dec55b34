"""A position in the tokens of a formula's text, the depth of nesting there, and errors that mark a place."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import FormulaError, place_of
from .tokens import FormulaToken, tokens

__all__ = ["MAX_NESTING", "Cursor"]

MAX_NESTING = 40
"""Deeper text would exhaust Python's stack; no real specification comes near."""


class Cursor:
    """The next token of a formula's text; it only moves forward.

    Raises:
        FormulaError: the text has a character that no formula has, or too many tokens.

    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = tokens(text)
        self._next = 0
        self._depth = 0

    @property
    def token(self) -> FormulaToken:
        """The next token."""
        return self._tokens[self._next]

    @property
    def before(self) -> FormulaToken:
        """The last token that it moved past."""
        return self._tokens[self._next - 1]

    @property
    def following(self) -> tuple[FormulaToken, FormulaToken]:
        """The next two tokens; behind the end there is the end."""
        return self.token, self.ahead(1)

    def ahead(self, number: int) -> FormulaToken:
        """Return the token behind so many others; behind the end there is the end."""
        return self._tokens[min(self._next + number, len(self._tokens) - 1)]

    def advance(self) -> None:
        """Move past the next token."""
        self._next += 1

    def take(self, *texts: str) -> str | None:
        """Move past the next token and return its text if it is one of `texts`."""
        token = self.token
        if token.kind in {"sign", "word"} and token.text in texts:
            self.advance()
            return token.text
        return None

    def error(self, reason: str, token: FormulaToken | None = None) -> FormulaError:
        """Return the error that marks `token`, by default the next one."""
        place = token or self.token
        return FormulaError(reason, self._text, place.position, len(place.text))

    def place(self, token: FormulaToken) -> str:
        """Return where a token is, in words."""
        return place_of(self._text, token.position)

    @contextmanager
    def nested(self) -> Iterator[None]:
        """Count one level of nesting.

        Raises:
            FormulaError: it is deeper than `MAX_NESTING`.

        """
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise self.error(f"more than {MAX_NESTING} levels of nesting")
        yield
        self._depth -= 1

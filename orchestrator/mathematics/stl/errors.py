"""The error of a specification, on one line."""

from typing import ClassVar

__all__ = ["FormulaError", "place_of"]


class FormulaError(ValueError):
    """A specification that is no formula, or that does not fit a trajectory; one line with the place and the remedy.

    `reason` is the message without the place. `position` counts the characters before the place, from the start of the
    text; None for a formula that does not fit the trajectory (its horizon, an interval without sample).
    """

    SHOWN: ClassVar[int] = 60
    """Characters of the text before and after the place in a message."""

    def __init__(self, reason: str, text: str = "", position: int | None = None, length: int = 1) -> None:
        self.reason, self.position = reason, position
        super().__init__(
            reason if position is None else f"{place_of(text, position)}: {reason} : {_mark(text, position, length)}"
        )


def place_of(text: str, position: int) -> str:
    """Return a position in words; of a text with several lines with its line."""
    line = text.count("\n", 0, position)
    character = position - (text.rfind("\n", 0, position) + 1) + 1
    return f"line {line + 1}, character {character}" if "\n" in text.rstrip() else f"character {character}"


def _mark(text: str, position: int, length: int) -> str:
    before, here, after = text[:position], text[position : position + length], text[position + length :]
    here = here or "end"
    if len(before) > FormulaError.SHOWN:
        before = "..." + before[-FormulaError.SHOWN :]
    if len(after) > FormulaError.SHOWN:
        after = after[: FormulaError.SHOWN] + "..."
    line = f"{before}>>>{here}<<<{after}"
    return "".join(character if character.isprintable() else " " for character in line).strip()

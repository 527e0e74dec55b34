"""Several requirements instead of one specification: each has a name, a formula, and where it comes from."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field

from .base import Model

MOST = 50


def _left_out(text: str, longest: int) -> Any:
    return Field(default=None, max_length=longest, exclude_if=lambda value: value is None, description=text)


class Requirement(Model):
    """One requirement; in a file its name is the key, and a text alone is short for its formula."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$", description="the key under `[specifications]`")
    formula: str = Field(max_length=10_000, description="STL formula over trajectory columns")
    id: str | None = _left_out("of the requirement in its document", 200)
    text: str | None = _left_out("the requirement as it is written there", 2000)
    link: str | None = _left_out("to it", 2000)


def listed(table: Any) -> Any:
    """Return the tables under `[specifications]` as a list in their order; any other value as it is.

    >>> listed({"gap": "always (d > 2)", "stop": {"formula": "eventually (v < 1)", "id": "R-1"}})[1]
    {'name': 'stop', 'formula': 'eventually (v < 1)', 'id': 'R-1'}
    """
    if not isinstance(table, Mapping):
        return table
    return [
        {"name": name, **each} if isinstance(each, Mapping) else {"name": name, "formula": each}
        for name, each in table.items()
    ]


def conjunction(requirements: Sequence[Requirement]) -> str:
    """Return the formula that holds if every requirement does; its robustness is the least one of theirs.

    >>> conjunction([Requirement(name="gap", formula="d > 2"), Requirement(name="stop", formula="v < 1")])
    '(d > 2) and (v < 1)'
    """
    return " and ".join(f"({each.formula})" for each in requirements)

"""Several requirements instead of one specification: each has a name, a formula, and where it comes from.

Method `sample` makes every claim from the same draws. A method that chooses its tests bounds each requirement on its
own, from the same rollouts, with the constants of the problem or with those that the requirement has.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from ..base import Model
from .problem_models import Linearised, MaternKernel

MOST = 50
OWN_CONSTANT = "instead of the problem's; not with method `sample`"


def _left_out(text: str, longest: int) -> Any:
    return Field(default=None, max_length=longest, exclude_if=lambda value: value is None, description=text)


def _own_constant() -> Any:
    return Field(
        default=None,
        exclude_if=lambda value: value is None,
        description=OWN_CONSTANT,
    )


class Requirement(Model):
    """One requirement; in a file its name is the key, and a text alone is short for its formula."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$", description="the key under `[specifications]`")
    formula: str = Field(max_length=10_000, description="STL formula over trajectory columns")
    id: str | None = _left_out("of the requirement in its document", 200)
    text: str | None = _left_out("the requirement as it is written there", 2000)
    link: str | None = _left_out("to the document", 2000)
    alpha: Annotated[float, Field(gt=0)] | None = _own_constant()
    rkhs_norm: Annotated[float, Field(gt=0)] | None = _own_constant()
    prior_mean: float | None = _own_constant()
    noise_scale: Literal["derived"] | Annotated[float, Field(ge=0)] | None = _own_constant()
    misspecification: Annotated[float, Field(ge=0)] | None = _own_constant()
    kernel: MaternKernel | None = _own_constant()
    linearised: Linearised | None = _own_constant()

    @property
    def constants(self) -> dict[str, Any]:
        """The keys of the problem that this requirement has a value of its own for."""
        return self.model_dump(exclude_none=True, exclude={"name", "formula", "id", "text", "link"})


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

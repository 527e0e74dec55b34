"""Several requirements instead of one specification: each has a name, a formula, and where it comes from.

Method `sample` makes every claim from the same draws. A method that chooses its tests bounds each requirement on its
own, from the same rollouts, with the constants of the problem or with those that the requirement has.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from ..base import Model, key_if_given
from .problem_models import Linearised, MaternKernel

MOST = 50
OWN_CONSTANT = "instead of the problem's; not with method `sample`"


class Requirement(Model):
    """One requirement; in a file its name is the key, and a text alone is short for its formula."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$", description="the key under `[specifications]`")
    formula: str = Field(max_length=10_000, description="STL formula over trajectory columns")
    id: str | None = key_if_given("of the requirement in its document", max_length=200)
    text: str | None = key_if_given("the requirement as it is written there", max_length=2000)
    link: str | None = key_if_given("to the document", max_length=2000)
    alpha: Annotated[float, Field(gt=0)] | None = key_if_given(OWN_CONSTANT)
    rkhs_norm: Annotated[float, Field(gt=0)] | None = key_if_given(OWN_CONSTANT)
    prior_mean: float | None = key_if_given(OWN_CONSTANT)
    noise_scale: Literal["derived"] | Annotated[float, Field(ge=0)] | None = key_if_given(OWN_CONSTANT)
    misspecification: Annotated[float, Field(ge=0)] | None = key_if_given(OWN_CONSTANT)
    kernel: MaternKernel | None = key_if_given(OWN_CONSTANT)
    linearised: Linearised | None = key_if_given(OWN_CONSTANT)

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


def conjunction(formulas: Iterable[str]) -> str:
    """Return the formula that holds if every one of these does; its robustness is the least one of theirs.

    >>> conjunction(["d > 2", "v < 1"])
    '(d > 2) and (v < 1)'
    """
    return " and ".join(f"({each})" for each in formulas)

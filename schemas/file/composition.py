"""Claims from the bounds of problems, the rules that compose two bounds, and the methods that each rule is for."""

from collections.abc import Iterable
from typing import Literal, TypeGuard

from pydantic import Field

from ..base import Model
from .objectives import ProblemName

Rule = Literal["product", "sum", "bhatia-davis", "pointwise", "single"]
ClaimRule = Literal[Rule, "every"]
"""The rule of a claim: `every` is about all requirements, each of which has a bound of its own."""
PAIR: tuple[ProblemName, ProblemName] = ("nominal_robustness", "sim_gap")
"""The problems whose bounds compose to one of the true system."""


class ComposedClaim(Model):
    """A claim that is asked for, from the bounds of one problem or of two."""

    rule: Rule = Field(
        description="for `nominal_robustness` and `sim_gap`, Theorem 2 with multiplied probabilities, or with added "
        "failure "
        "probabilities; Bhatia-Davis with two extremes, or pointwise; `single`: the bound of one problem"
    )
    problems: tuple[ProblemName, ...] = Field(
        min_length=1, max_length=2, description="whose bounds the claim is made from"
    )


def composes(rule: ClaimRule) -> TypeGuard[Rule]:
    """Whether a rule composes the bounds of the pair."""
    return rule not in ("single", "every")


def is_composed(asked: object) -> bool:
    """Whether an entry of `[[claims]]`, as a table or as a model, is made from the bounds of problems.

    >>> is_composed({"rule": "single", "problems": ["true_risk"]}), is_composed({"quantity": "cvar", "level": 0.1})
    (True, False)
    """
    return "rule" in asked if isinstance(asked, dict) else isinstance(asked, ComposedClaim)


def composed_claims(asked: Iterable[object]) -> tuple[ComposedClaim, ...]:
    """Return the claims by a rule among the entries of `[[claims]]`; without any, `composition` decides them."""
    return tuple(each for each in asked if isinstance(each, ComposedClaim))

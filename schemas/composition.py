"""Claims from the bounds of problems, the rules that compose two bounds, and the methods that each rule is for."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal, TypeGuard

from pydantic import Field

from .base import Model
from .problem_models import Problem
from .problems import CLAIMS, ProblemName, any_of

if TYPE_CHECKING:
    from .campaign import CampaignConfig

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


def check_composition(config: "CampaignConfig") -> None:
    """Refuse a rule that the problems or their methods have no bound for.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    composed = composed_claims(config.claims)
    if composed:
        if len(composed) < len(config.claims):
            raise ValueError("claims: of drawn starts, or by a rule, not both in one campaign")
        if config.specifications or any(problem.method == "sample" for problem in config.problems):
            raise ValueError("claims: a rule is for methods that bound a worst start, and for one specification")
        if config.composition != "single":
            raise ValueError("composition: is short for one entry of [[claims]]; remove one of the two")
        _check_composed(config, composed)
        return
    names = tuple(problem.name for problem in config.problems)
    if config.composition == "single":
        if len(names) != 1:
            raise ValueError("composition: 'single' is for one problem; allowed here: 'product', 'sum'")
        _check_single(names, "composition")
        return
    if not set(PAIR) <= set(names):
        raise ValueError(f"composition: {config.composition!r} needs the problems {' and '.join(map(repr, PAIR))}")
    _check_rule(config, config.composition, "composition")


def _check_composed(config: "CampaignConfig", composed: Sequence[ComposedClaim]) -> None:
    names = [problem.name for problem in config.problems]
    for number, claim in enumerate(composed):
        where = f"claims.{number}"
        if claim in composed[:number]:
            raise ValueError(f"{where}: is there twice; list every claim once")
        for name in claim.problems:
            if name not in names:
                raise ValueError(f"{where}.problems: no problem {name!r} here; choose of {', '.join(names)}")
        if claim.rule == "single":
            if len(claim.problems) != 1:
                raise ValueError(f"{where}.problems: rule 'single' is for one problem")
            _check_single(claim.problems, f"{where}.rule")
        elif claim.problems != PAIR:
            raise ValueError(f"{where}.problems: rule {claim.rule!r} is for {list(PAIR)}")
        else:
            _check_rule(config, claim.rule, f"{where}.rule")
    for name in names:
        if all(name not in claim.problems for claim in composed):
            raise ValueError(f"claims: none uses the problem {name!r}; add one, or remove the problem")


def _check_single(names: tuple[ProblemName, ...], where: str) -> None:
    if set(names) & set(PAIR):
        raise ValueError(f"{where}: 'single' makes a claim of {any_of(CLAIMS)} only")


def _check_rule(config: "CampaignConfig", rule: Rule, where: str) -> None:
    pair: list[Problem] = [problem for problem in config.problems if problem.name in PAIR]
    methods = {problem.method for problem in pair}
    if rule == "product" and methods != {"paper"}:
        raise ValueError(f"{where}: 'product' is for method 'paper'; 'sum' holds for every method")
    if rule == "pointwise" and methods != {"rigorous"}:
        raise ValueError(f"{where}: {rule!r} needs method 'rigorous' in both problems")
    if rule == "bhatia-davis" and "paper" in methods:
        raise ValueError(f"{where}: {rule!r} is not for method 'paper'; choose 'rigorous' in both problems")
    if rule == "pointwise" and len({config.resolution_of(problem) for problem in pair}) != 1:
        raise ValueError(f"{where}: 'pointwise' needs one resolution for both problems")

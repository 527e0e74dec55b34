"""The parts of a campaign with several requirements: the campaign of each requirement by itself."""

from typing import TypeVar

from pydantic import ValidationError

from .keys import CampaignKeys
from .problem_models import Problem
from .requirements import Requirement

Keys = TypeVar("Keys", bound=CampaignKeys)


def alpha_of(config: CampaignKeys, problem: Problem) -> float | None:
    """Return the tolerance that ends a problem; None where it has none, or each of its requirements its own."""
    return None if config.specifications else problem.alpha


def parts_of(config: Keys) -> tuple[Keys, ...]:
    """Return the campaign of each requirement by itself, for methods that bound each one on its own; else none.

    Raises:
        ValueError: a requirement has a key that its method cannot have.

    """
    if not config.specifications or config.problems[0].method == "sample":
        return ()
    (problem,) = config.problems
    return tuple(
        config.model_copy(
            update={"specification": each.formula, "specifications": (), "problems": (_with_constants(problem, each),)}
        )
        for each in config.specifications
    )


def _with_constants(problem: Problem, requirement: Requirement) -> Problem:
    """Return the problem of one requirement.

    Raises:
        ValueError: one line with the requirement, the key and the remedy.

    """
    known = type(problem).model_fields
    for key in requirement.constants:
        if key not in known:
            raise ValueError(
                f"specifications.{requirement.name}.{key}: has no meaning in method {problem.method!r}; remove this key"
            )
    try:
        return type(problem).model_validate(problem.model_dump(exclude_unset=True) | requirement.constants)
    except ValidationError as error:
        # The problem alone was valid, so that a key of the requirement is at fault.
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        own = reason.partition(":")[0].partition(".")[0] in requirement.constants
        raise ValueError(f"specifications.{requirement.name}{'.' if own else ': '}{reason}") from None

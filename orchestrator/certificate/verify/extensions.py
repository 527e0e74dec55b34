"""The extensions of a certificate: the larger budgets that it lists, as facts for the rerun of the campaign."""

from ....schemas.result.certificate import Assumption, Certificate
from ....schemas.result.facts import ExtensionFact
from ..assumptions import EXTENDED
from .checks import CheckFailed


def extended(certificate: Certificate) -> tuple[ExtensionFact, ...]:
    """Return the extensions that a certificate lists; whether the campaign allows them the rerun decides.

    Raises:
        CheckFailed: they are not numbered from 1, or name no budget.

    """
    budgets: dict[int, dict[str, int]] = {}
    for each in certificate.predicate.assumptions:
        if each.id.startswith(EXTENDED):
            number, problem, tests = _of_line(each)
            budgets.setdefault(number, {})[problem] = tests  # one line for each requirement of the problem
    if list(budgets) != list(range(1, len(budgets) + 1)):
        raise CheckFailed("stop", "its extensions are not numbered from 1 in their order")
    return tuple(ExtensionFact(number, tuple(listed.items())) for number, listed in budgets.items())


def _of_line(found: Assumption) -> tuple[int, str, int]:
    number, values = found.id.removeprefix(EXTENDED).partition("/")[0], found.values
    problem, tests = values.get("problem"), values.get("max_tests")
    if not number.isdecimal() or not isinstance(problem, str) or not isinstance(tests, int):
        raise CheckFailed("stop", f"{found.id[:80]} names no budget")
    return int(number), problem, tests

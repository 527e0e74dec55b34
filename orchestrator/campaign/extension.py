"""The extension of a campaign that has ended by its budget: where it is valid, and the fact of it.

The decision to go on may depend on every rollout so far. So it needs bounds that hold after every test at once, with
one probability for all of them: then no choice of the last test can miss it.
"""

from collections.abc import Mapping

from ...schemas.errors import CampaignError, IllegalEvent
from ...schemas.result.facts import ExtensionFact
from .closing.checks import ClosingChecks
from .plan import ProblemPlan, within_starts
from .series import Account


def extension(accounts: Mapping[str, Account], closing: ClosingChecks, number: int, max_tests: int) -> ExtensionFact:
    """Return the fact that gives problems that have spent their budget a larger one; `number` counts from 1.

    Raises:
        CampaignError: it would not be valid, or changes nothing; the text says why.

    """
    for account in accounts.values():
        if (reason := _not_at_every_test(account.plan)) is not None:
            raise CampaignError(f"problem {account.plan.name}: {reason}")
    # Else a refutation could be extended away.
    if (fault := closing.fault) is not None:
        raise CampaignError(f"{fault}, which more tests do not change; start a new campaign that does not assume it")
    spent = {name: each for name, each in accounts.items() if _has_spent(each)}
    if not spent:
        ends = ", ".join(f"{name}: {each.last_bound.stopped_by}" for name, each in accounts.items() if each.last_bound)
        raise CampaignError(f"no problem ended by its budget ({ends}), and an answered one needs no further test")
    largest = max(each.budget for each in spent.values())
    if max_tests <= largest:
        raise CampaignError(f"max_tests {max_tests} is no more than the {largest} tests so far; choose a larger number")
    budgets = {name: within_starts(each.plan, max_tests) for name, each in spent.items()}
    larger = tuple((name, tests) for name, tests in budgets.items() if tests > spent[name].budget)
    if not larger:
        raise CampaignError("every start has been tested, and without noise a further test shows nothing")
    return ExtensionFact(number, larger)


def is_extension_to(fact: ExtensionFact, accounts: Mapping[str, Account], max_tests: int) -> bool:
    """Whether a recorded extension is the one that this number of tests asks for."""
    return all(tests == within_starts(accounts[name].plan, max_tests) for name, tests in fact.budgets)


def extension_words(fact: ExtensionFact, max_tests: int) -> str:
    """Return what an extension gives, and why a problem gets fewer tests than asked for.

    >>> extension_words(ExtensionFact(1, (("robustness", 441),)), 700)
    'extended to 441 tests, not 700: without noise one test of each of the 441 starts shows all'
    """
    fewer = [(name, tests) for name, tests in fact.budgets if tests < max_tests]
    if not fewer:
        return f"extended to {max_tests:,} tests"
    if len(fact.budgets) == 1:
        ((_, tests),) = fewer
        why = f"without noise one test of each of the {tests:,} starts shows all"
        return f"extended to {tests:,} tests, not {max_tests:,}: {why}"
    each = ", ".join(f"{name} to {tests:,}" for name, tests in fewer)
    return f"extended to {max_tests:,} tests, {each}: without noise one test of each start shows all"


def check_extension(fact: ExtensionFact, accounts: Mapping[str, Account], closing: ClosingChecks, number: int) -> None:
    """Refuse a fact that is not the extension of this campaign at this moment.

    Raises:
        IllegalEvent: it is not.

    """
    try:
        expected = extension(accounts, closing, number, max((tests for _, tests in fact.budgets), default=0))
    except CampaignError as error:
        raise IllegalEvent(f"extension {fact.number}: {error}") from None
    if fact != expected:
        raise IllegalEvent(f"extension {fact.number} is not the one that follows, {expected}")


def _has_spent(account: Account) -> bool:
    return account.last_bound is not None and account.last_bound.stopped_by == "budget"


def _not_at_every_test(plan: ProblemPlan) -> str | None:
    """Return why the bound of a problem does not hold after every test; None if it does."""
    match plan.problem.method:
        case "paper":
            return (
                "method 'paper' claims its bound for the one test at which its rule or its budget ends it, so a budget "
                "that is chosen afterwards has no probability; start a new campaign with a larger max_tests"
            )
        case "kriging":
            return (
                f"method 'kriging' plans every start and weight for {plan.budget} tests, and proposes none after them; "
                "start a new campaign with a larger max_tests"
            )
        case "sample" if not plan.at_every_moment:
            return (
                f"the number of samples was fixed at {plan.budget}, and its claims hold at this number alone; start a "
                "new campaign with a larger max_tests and another seed"
            )
    return None

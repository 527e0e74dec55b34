"""What the claims of a stopped campaign are made from: each problem, or each requirement that is bounded on its own."""

from array import array
from collections.abc import Mapping
from dataclasses import replace

from ...schemas.result.facts import BoundFact
from ...schemas.values import Bound
from ..mathematics.bounds.joint import JointMethod
from .methods import Methods
from .observation import of_requirement
from .plan import ProblemPlan
from .series import Account, Rows


def bounded_accounts(accounts: Mapping[str, Account], methods: Methods) -> dict[str, Account]:
    """Return the account of everything that has a bound of its own, by the key of its plan.

    The requirements of a problem share its tests and rollouts; each has its own observations and its own bound.
    """
    found: dict[str, Account] = {}
    for account in accounts.values():
        method = methods[account.plan.key]
        if isinstance(method, JointMethod):
            pairs = zip(account.plan.parts, method.bounds, strict=True)
            # As if each were a problem of its own: certificate, spot check and report need not ask how many there are.
            found |= {part.key: _part(account, place, part, bound) for place, (part, bound) in enumerate(pairs)}
        else:
            found[account.plan.key] = account
    return found


def _part(account: Account, place: int, plan: ProblemPlan, bound: Bound) -> Account:
    each = [of_requirement(account.plan, place, observation) for observation in account.observed]
    last = account.last_bound
    return Account(
        account.link,
        plan=plan,
        observations=array("d", (observation.y for observation in each)),
        each=Rows(observation.each for observation in each),
        nodes=account.nodes,
        counts=account.counts,
        last_proposal=account.last_proposal,
        last_bound=None if last is None else _with_end(last, bound),
        proposed=account.proposed,
        # Of the whole specification: its clip is that of every requirement.
        robustness=account.robustness,
    )


def _with_end(last: BoundFact, bound: Bound) -> BoundFact:
    # A requirement without a verdict ended with the whole: by its budget, or by a counterexample.
    return replace(last, bound=replace(bound, verdict=bound.verdict or last.bound.verdict))

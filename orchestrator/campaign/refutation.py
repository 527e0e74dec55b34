"""The refutation that ends a problem of a campaign with `on_refuted = "stop"`: of an assumption, by its closed tests.

It follows from the tests in their order, not from the order of the results, so that the number and the speed of the
workers change nothing, and `verify` decides the same. The tests are valid at every moment, and so are the bounds of the
methods that may end there; a claim that rests on what is refuted says so, whatever its bound.
"""

from collections.abc import Mapping
from dataclasses import replace

from ...schemas.file.problem_models import RigorousProblem
from ...schemas.result.facts import Header
from ...schemas.values import Bound
from .account import Account
from .bounded import bounded_accounts
from .methods import Methods
from .tested import OneLaw, is_dominated, same_values, spread


class Refutation:
    """The rule of one problem; its bounds pass through `ended` in test order, each once."""

    def __init__(self, header: Header, account: Account, methods: Methods) -> None:
        self._applies = header.config.on_refuted == "stop"
        self._account, self._methods = account, methods
        self._is_noisy = not set(header.spec.noisy).isdisjoint(account.plan.variants)
        self._laws: dict[str, OneLaw] = {}

    def ended(self, bound: Bound) -> Bound:
        """Return the bound after the last closed test, which ends the problem if an assumption is refuted there."""
        if not self._applies or bound.verdict == "refuted":
            return bound
        return replace(bound, verdict="refuted") if self._is_refuted() else bound

    def _is_refuted(self) -> bool:
        accounts: Mapping[str, Account] = bounded_accounts({self._account.plan.key: self._account}, self._methods)
        return any(self._refutes(key, account) for key, account in accounts.items())

    def _refutes(self, key: str, account: Account) -> bool:
        law = self._laws.setdefault(key, OneLaw(account.plan))
        changed = self._is_noisy and law.finding(account.nodes, account.each).status == "refuted"
        return changed or not is_dominated(account.excess) or _refutes_noise(account)


def _refutes_noise(account: Account) -> bool:
    """Whether the values contradict the noise scale, or that there is none."""
    problem = account.plan.problem
    if not isinstance(problem, RigorousProblem):
        return False  # it assumes no noise scale
    found = same_values(account) if account.plan.noise == 0 else spread(account, problem.delta)
    return found is not None and found.status == "refuted"

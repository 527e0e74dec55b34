"""The audit and the verdict of a campaign that has not ended: what would hold if it ended now.

By the functions of the certificate, without those that read trajectories or cover the box. No certificate, no decision
and no verification depends on it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ...schemas.file.bases import bases
from ...schemas.result.certificate import Assumption, Predicate
from ...schemas.result.facts import Header
from ...schemas.result.known import CampaignVerdict, Violations
from ..campaign.assumption_tests import DeclaredLaws, OneLaw
from ..campaign.bounded_parts import bounded_accounts
from ..campaign.ledger import Ledger, failed_attempts
from ..campaign.series import Account
from .assumptions.audit import ClosingResults, assumptions
from .assumptions.sampled import declared_laws, noisy_variants, one_law
from .assumptions.sentences import assumption
from .claims import claims, of_listed_starts
from .closing_checks import recheck, spot_check
from .counter_evidence import Values
from .problem_results import Results, result
from .sensitivity import with_clip, without_rollouts
from .verdict import campaign_verdict

TESTED = ("refuted", "not refuted")
"""The statuses of assumptions that data were compared with, in the order in which a reader needs them."""


@dataclass(frozen=True, slots=True)
class Holding:
    """What holds if the campaign ends now."""

    assumptions: tuple[Assumption, ...]
    """Those that were tested, refuted ones first."""
    verdict: CampaignVerdict | None
    """None while nothing is proven."""
    others: tuple[str, ...]
    """The ids of those that only further claims rest on."""

    @property
    def refuted(self) -> bool:
        """Whether the first claim rests on a refuted assumption."""
        return any(each.status == "refuted" and each.id not in self.others for each in self.assumptions)


@dataclass(slots=True)
class AuditSoFar:
    """The audit of one running campaign; its tests of one law take each test once."""

    ledger: Ledger
    _laws: dict[str, OneLaw] = field(default_factory=dict)
    _reported: dict[str, DeclaredLaws] = field(default_factory=dict)

    def holding(
        self, violations: Violations, values: Callable[[], Values], *, unit: str, irreproducible: int
    ) -> Holding:
        """Return what holds now; `values` are the rollouts of the tested variant, read only where needed.

        `irreproducible` is that of `issue`.
        """
        accounts = {name: each for name, each in self._accounts().items() if each.observations}
        found = self._assumptions(accounts, irreproducible=irreproducible)
        tested = [each for each in found if each.status in TESTED]
        tested.sort(key=lambda each: (TESTED.index(each.status), not self._concerns_first_claim(each)))
        predicate = self._predicate(accounts, found)
        header = self.ledger.header
        verdict = campaign_verdict(header, predicate, violations, values, unit=unit) if predicate is not None else None
        others = tuple(each.id for each in tested if not self._concerns_first_claim(each))
        return Holding(tuple(tested), verdict, others)

    def _concerns_first_claim(self, found: Assumption) -> bool:
        """Whether the first claim rests on an assumption: of its problems, or of the whole campaign."""
        _, _, problem = found.id.partition("/")
        return not problem or problem in bases(self.ledger.config)[0].problems

    def _accounts(self) -> dict[str, Account]:
        return bounded_accounts(self.ledger.accounts, self.ledger.methods)

    def _assumptions(self, accounts: Mapping[str, Account], *, irreproducible: int) -> list[Assumption]:
        if not accounts:
            return []
        closing = self.ledger.closing
        # A check that is under way has shown nothing yet, unless it has refuted something.
        checked = spot_check(self.ledger) if closing.spot_check and closing.spot_check.refuted else None
        repeated = recheck(self.ledger) if closing.recheck and closing.recheck.differing else None
        results = ClosingResults(checked, repeated)
        failed = irreproducible + failed_attempts(self.ledger)
        return assumptions(self.ledger, accounts, results, failed=failed, sampled=self._sampled)

    def _sampled(self, account: Account) -> Iterator[Assumption]:
        """Yield what the bound of a noisy problem needs of its samples, without comparing trajectories."""
        if not noisy_variants(self.ledger, account):
            return
        plan = account.plan
        values = {"rollouts": sum(account.counts.values()), "compared": 0, "copies": 0}
        yield assumption(f"independent_rollouts/{plan.key}", "assumed", values)
        law = self._laws.setdefault(plan.key, OneLaw(plan))
        yield one_law(plan, law.finding(account.nodes, account.each))
        if plan.reports is not None:
            declared = self.ledger.header.spec.reported
            reported = self._reported.setdefault(plan.key, DeclaredLaws(plan, declared))
            yield declared_laws(plan, declared, reported.finding(account.each))

    def _predicate(self, accounts: Mapping[str, Account], found: list[Assumption]) -> Predicate | None:
        """Return the first claim and the problems as a certificate would have them now.

        None while a problem that this claim follows from has no bound; the others may have none.
        """
        config, methods = self.ledger.config, self.ledger.methods
        accounts = {key: account for key, account in accounts.items() if self._has_bound(account)}
        first = bases(config)[:1]
        if not set(first[0].problems) <= accounts.keys():
            return None
        plans = {key: account.plan for key, account in accounts.items()}
        results: Results = {key: result(_as_ended(account)) for key, account in accounts.items()}
        made = claims(config, plans, results, methods, found, at_each_start=False, first_alone=True).claims
        results = with_clip(results, config)
        made = of_listed_starts(without_rollouts(made, config, plans, results), first, plans)
        # Nothing else is asked of it: it is no certificate, and has no evidence. Its closing checks are still to come.
        content: dict[str, Any] = {"claims": made, "problems": tuple(results.values()), "assumptions": tuple(found)}
        content |= {"counterexample": None, "spot_check": None}
        return Predicate.model_construct(**content)

    def _has_bound(self, account: Account) -> bool:
        last, problem = account.last_bound, account.plan.problem
        if last is None or last.bound.upper is None:
            return False
        return last.stopped_by is not None or not problem.bound_at_end


def _as_ended(account: Account) -> Account:
    """Return the account of a problem as if its last test had ended it."""
    last = account.last_bound
    assert last is not None, "it has a bound"
    if last.stopped_by is not None:
        return account
    # As if by its tolerance: a reason that names a spent budget would be false.
    return replace(account, last_bound=replace(last, bound=replace(last.bound, verdict="converged")))


def claims_nothing_yet(header: Header) -> str:
    """Return the sentence on a campaign that has no bound so far."""
    fixed = [each.method for each in header.config.problems if each.bound_at_end]
    if fixed:
        return f"Method {fixed[0]} claims nothing before its last test."
    return "Nothing is proven yet: too few tests have ended."

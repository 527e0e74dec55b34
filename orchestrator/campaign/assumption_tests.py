"""Tests of the assumptions of a problem that need its closed tests alone, at any moment of the campaign.

The audit of the certificate makes them at the end; a campaign that ends where an assumption is refuted makes them after
every test. Each is valid at every moment, also at one that depends on the outcomes.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...schemas.draws.laws import ReportedLaws
from ...schemas.file.disturbance import Disturbance
from ...schemas.file.problem_models import RigorousProblem
from ...schemas.result.facts import Header
from ...schemas.values import Bound
from ..mathematics.bounds.checks import audit
from ..mathematics.bounds.checks.audit import Finding
from ..mathematics.bounds.checks.law import LawTest
from ..mathematics.bounds.checks.stationarity import AdaptiveOrderTest
from .bounded_parts import bounded_accounts
from .methods import Methods
from .plan import ProblemPlan
from .series import Account, Rows

ROUNDING = 1e-9
"""A gap that dominates may be exceeded by so much in the last digits."""


def same_values(account: Account) -> Finding:
    """Test that rollouts at one start agree bit by bit: of a problem without noise."""
    places = sorted(zip(account.nodes, account.each, strict=True))
    by_place = itertools.groupby(places, key=lambda place: place[0])
    return audit.deterministic_variant([[value for _, each in group for value in each] for _, group in by_place])


def spread(account: Account, delta: float) -> Finding | None:
    """Test the noise scale against the spread of replicates; None where no test has two."""
    plan = account.plan
    # The budget, not the number of tests made: the test is valid at every N only with a constant fixed beforehand.
    planned = plan.budget * plan.replicates
    return audit.replicate_spread(account.each, noise_scale=plan.noise_per_rollout, delta=delta, planned=planned)


def is_dominated(excess: float) -> bool:
    """Whether the gap, times its constant, was at least the robustness difference of every pair of rollouts."""
    return excess <= ROUNDING


@dataclass(slots=True)
class OneLaw:
    """The test that the rollouts of a start have one law during the campaign; each closed test is taken once."""

    plan: ProblemPlan
    taken: int = 0
    _order: AdaptiveOrderTest = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a value."""
        # A list of starts is fixed beforehand; on a box nobody knows how many candidates are tested twice. Drawn starts
        # are one column: where start and rollout have one law, so have the values.
        self._order = AdaptiveOrderTest(starts=1 if self._drawn else self.plan.listed)

    @property
    def _drawn(self) -> bool:
        return self.plan.candidates is None

    def finding(self, nodes: Sequence[int], each: Rows) -> Finding:
        """Take the closed tests that are new, and return the finding about all of them."""
        tests = range(self.taken, len(nodes))
        if self._drawn:
            values = each.firsts(self.taken)
            # A search chose the others by the outcomes before.
            taken = np.fromiter(map(self.plan.is_drawn, tests), np.bool_, len(tests))
            self._order.observe_each(0, np.array(tests)[taken], values[taken])
        else:
            for test in tests:
                for value in self.plan.values_of(each[test]):
                    self._order.observe(nodes[test], test, value)
        self.taken = len(nodes)
        return self._order.finding()


@dataclass(slots=True)
class DeclaredLaws:
    """The test that what rollouts report has the laws that the system declares; each closed test is taken once."""

    plan: ProblemPlan
    laws: tuple[Disturbance, ...]
    taken: int = 0
    _test: LawTest = field(init=False)
    _known: ReportedLaws = field(init=False)
    # Independent of the values: any fixed sequence is.
    _between: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a number."""
        self._test, self._known = LawTest(len(self.laws)), ReportedLaws(self.laws)
        self._between = np.random.default_rng(0)

    def finding(self, each: Rows) -> Finding:
        """Take the closed tests that are new, and return the finding about all of them."""
        tests = list(map(self.plan.reported_of, each[self.taken :]))
        self.taken = len(each)
        if tests:
            values = np.array(tests).reshape(-1, len(self.laws))
            self._test.observe(self._known.shares(values, self._between.random(values.shape)))
        return self._test.finding()


# The refutation that ends a problem of a campaign with `on_refuted = "stop"`. It follows from the tests in their order,
# not from the order of the results, so that the number and the speed of the workers change nothing, and `verify`
# decides the same. The tests are valid at every moment, and so are the bounds of the methods that may end there; a
# claim that rests on what is refuted says so, whatever its bound.


class Refutation:
    """The rule of one problem; its bounds pass through `ended` in test order, each once."""

    def __init__(self, header: Header, account: Account, methods: Methods) -> None:
        self._applies = header.config.on_refuted == "stop"
        self._account, self._methods = account, methods
        self._is_noisy = not set(header.spec.noisy).isdisjoint(account.plan.variants)
        self._laws: dict[str, OneLaw] = {}
        plan = account.plan
        self._reported = None if plan.reports is None else DeclaredLaws(plan, header.spec.reported)

    def ended(self, bound: Bound) -> Bound:
        """Return the bound after the last closed test, which ends the problem if an assumption is refuted there."""
        if not self._applies or bound.verdict == "refuted":
            return bound
        return replace(bound, verdict="refuted") if self._is_refuted() else bound

    def _is_refuted(self) -> bool:
        if self._reported is not None and self._reported.finding(self._account.each).status == "refuted":
            return True
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

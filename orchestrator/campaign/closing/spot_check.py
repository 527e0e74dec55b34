"""The spot check of a finished campaign on a box: fresh uniform starts that test every bound without smoothness.

A bound of the worst of listed starts of a box is tested over the box as well: no fresh start refutes it, but the
finding says whether it may be read as one of the box.
"""

import math
from array import array
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, MutableSequence, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ....schemas.ids import SPOT_CHECK, RolloutId, of_extension
from ....schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact, each_fact
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation
from ...mathematics.bounds.checks.spot_check import Hypothesis, SpotFinding, SpotTests
from ...mathematics.bounds.rounding import round_up
from ...mathematics.gp.lattice import Lattice
from .. import state
from ..counterexample import counterexample
from ..decisions import UNOBSERVABLE, naming
from ..objectives import excess
from ..observation import Load, Observer, Others, Trajectories, block_trajectories
from ..plan import ProblemPlan, block_size, value_range
from ..ports import Recorded
from ..seeds import rollout_seed, rollout_seeds, uniform
from ..series import Account, Series
from ..starts import Draws

LEVEL = 0.05
"""Failure probability of each of its statements; after the k-th extension of the campaign this times 2^-k.

Whoever extends a campaign knows what its spot check found, and may stop after one that looks well. The starts of each
are fresh, so given everything before it its statements hold with their probability; and those of all spot checks after
extensions hold together but for LEVEL (1/2 + 1/4 + ...) = LEVEL, whenever the last extension was.
"""
NARROW = 8.0
"""A noise scale of at most this part of the range serves the bets; the derived one is half of it."""
WINDOW = 64
"""Tests in flight while follow-ups are chosen, each of them from the observations before."""


@dataclass(slots=True)
class SpotSeries(Series):
    """The facts of a spot check."""

    robustness: dict[int, tuple[float, ...]] = field(default_factory=dict)
    """Of the first test at each start, by the number of the start, for each replicate; of `tested_variant`."""
    clipped: dict[str, MutableSequence[float]] = field(default_factory=dict)
    """The robustness of every rollout, follow-ups too, by its variant."""

    def observe(self, fact: ObservationFact) -> list[RolloutFact]:
        """Close an observed test, as every series does, and take the robustness at a start that has none."""
        rollouts = Series.observe(self, fact)  # by name: `super()` finds no cell in a class with slots
        self._take(self.nodes[-1], rollouts)
        return rollouts

    def observe_block(self, fact: BlockObservationFact) -> list[BatchFact]:
        """Close an observed block, as `observe` closes a test."""
        batches = Series.observe_block(self, fact)
        for node, rollouts in zip(self.nodes[-len(fact) :], by_test(self.last_rollouts).values(), strict=True):
            self._take(node, rollouts)
        return batches

    def _take(self, node: int, rollouts: Sequence[RolloutFact]) -> None:
        tested = tested_variant({each.rollout.variant for each in rollouts})
        ordered = sorted(rollouts, key=lambda each: each.rollout)
        found = [each.robustness for each in ordered if each.rollout.variant == tested]
        # Of the first test alone: follow-ups go to suspicious starts, and are no fair sample.
        self.robustness.setdefault(node, tuple(value for value in found if value is not None))
        for each in rollouts:
            if each.robustness is not None:
                self.clipped.setdefault(each.rollout.variant, array("d")).append(each.robustness)


def by_test(rollouts: Iterable[RolloutFact]) -> dict[int, list[RolloutFact]]:
    """Return the rollouts of each test, in the order of the tests."""
    found = defaultdict[int, list[RolloutFact]](list)
    for each in rollouts:
        found[each.rollout.test].append(each)
    return dict(sorted(found.items()))


class SpotCheck:
    """The decider of the spot check; a test has rollouts of every variant that some problem needs, at one start.

    A follow-up has rollouts of noisy variants alone: the others are those of the first test there, test j at start j.
    With `batch` the first tests are in blocks, and follow-ups come after all of them, one by one: a window over both
    could have all drawn starts in it, and follow-ups would be chosen without an observation.
    `each` of an observation has J of every tested bound, in the order of the campaign file, for each replicate.
    """

    def __init__(
        self,
        header: Header,
        accounts: Mapping[str, Account],
        observer: Observer,
        recorded: Recorded,
        extensions: int = 0,
    ) -> None:
        # The name decides starts and seeds. It has the number of the extension and not its budget: who tried several
        # budgets would see the same starts.
        self.name = of_extension(SPOT_CHECK, extensions)
        self.level = LEVEL / 2**extensions
        self._header, self.observer, self._recorded = header, observer, recorded
        self._plans = [account.plan for account in accounts.values() if math.isfinite(_limit(account))]
        plan = spot_check_plan(header, self._plans, self.name)
        assert plan is not None, "`wanted` was asked"
        self.plan = plan
        self.variants = tuple(dict.fromkeys(variant for variant, _ in plan.rollouts))
        self._replicates = 1 + max(replicate for _, replicate in plan.rollouts)
        noisy = set(header.spec.noisy)
        hypotheses = [_hypothesis(each, _limit(accounts[each.key]), noisy) for each in self._plans]
        self.hypotheses = {each.key: found for each, found in zip(self._plans, hypotheses, strict=True)}
        self.starts = _uniform_starts(header, self._plans, self.name)
        followups = plan.most_tests - len(self.starts)
        self.excess = -math.inf
        """As of an account: above 0 the gap of some pair at a fresh start does not dominate."""
        self._first: dict[int, dict[str, float]] = {}
        """Robustness in the first replicate of the first test at each start, by the variant; where a gap is tested."""
        self._tests = SpotTests(
            self.starts, hypotheses, followups=followups, replicates=self._replicates, delta=self.level
        )

    @classmethod
    def wanted(cls, header: Header, accounts: Mapping[str, Account]) -> bool:
        """Whether the campaign has a spot check: on a box, or listed starts of one, where some problem has a bound.

        A counterexample has answered the question: no further start is simulated. Neither is one where the campaign
        is to end with a refutation.
        """
        if any(map(counterexample, accounts.values())):
            return False
        if header.config.on_refuted == "stop" and any(map(_is_refuted, accounts.values())):
            return False
        bounded = any(math.isfinite(_limit(account)) for account in accounts.values())
        return bounded and spot_check_plan(header, [account.plan for account in accounts.values()]) is not None

    def proposal(self, series: Series, test: int) -> ProposalFact:
        """Choose the next start: each one once, then the most suspicious ones."""
        pending = [fact.proposal.node for fact in series.proposals.values()]
        # The window is kept full: where every suspicious start has a test in flight, the first one gets one more.
        chosen = self._tests.propose(pending) or self._tests.propose()
        assert chosen is not None, "a spot check that is complete has ended"
        return ProposalFact(self.name, test, chosen)

    def block(self, series: Series, tests: range) -> BlockProposalFact:  # noqa: ARG002  (each start once)
        """Choose the next starts."""
        starts = np.array(self.starts[tests.start : tests.stop])
        return BlockProposalFact.of(self.name, tests.start, np.array(tests), starts)

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Return J of every tested problem for each replicate; y is the first one."""
        start = series.proposals[test].proposal.node
        missing = [(variant, 0) for variant in self.variants if (variant, 0) not in trajectories]
        first = {key: self._recorded.trajectory(RolloutId(self.name, start, *key)) for key in missing}
        with naming(f"{self.name}, test {test}", UNOBSERVABLE):
            values = self._values({**first, **trajectories})
        observed = Observation(values[0], values)
        return ObservationFact(self.name, test, observed, series.next_link(test, observed))

    def observed_block(self, series: Series, test: int, load: Load) -> BlockObservationFact:
        """Return the values of the tests of a block, which begins with `test`, each as `observation` does."""
        proposal, batches = series.blocks[test], series.batches[test]
        with naming(f"{self.name}, tests from {test}", UNOBSERVABLE):
            each = np.array([self._values(found) for found in block_trajectories(len(proposal), batches, load)])
        fact = BlockObservationFact.of(self.name, test, each[:, 0], each)
        return replace(fact, chain=series.next_block_link(proposal, batches, fact))

    needs_scores_alone = False
    """Whether an observation follows from the recorded scores of its rollouts: a column or a gap does not."""

    @property
    def measured(self) -> Set[str]:
        """What is measured of trajectories, as in `Objective`."""
        return {plan.objective.measured for plan in self._plans}

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Raise a ValueError if a rollout of an open test allows no observation, alone or with others of the test."""
        # Of a block test j is at start j.
        start = series.proposals[rollout.test].proposal.node if rollout.test in series.proposals else rollout.test
        noisy = set(self._header.spec.noisy)

        def used(key: tuple[str, int]) -> Iterable[Trajectory]:
            # A follow-up has no rollout of a variant without noise: that of the first test at its start serves.
            first = RolloutId(self.name, start, *key)
            return [self._recorded.trajectory(first)] if key[0] not in noisy and rollout.test != start else others(key)

        for plan in self._plans:
            if rollout.variant in plan.variants:
                paired = replace(plan, replicates=self._replicates, shared=frozenset(plan.variants) - noisy)
                self.observer.check(paired, rollout[2:], trajectory, used)

    def bound(self, series: Series, fact: ObservationFact | BlockObservationFact) -> BoundFact:
        """Take an observation; the check ends with its budget, or when no start is suspicious."""
        rollouts, last = by_test(series.last_rollouts), fact.test + len(fact) - 1
        with naming(f"{self.name}, test {fact.test}"):
            for node, each in zip(series.nodes[-len(fact) :], each_fact([fact]), strict=True):
                assert isinstance(each, ObservationFact)
                self._take(node, each.observation.each, rollouts[each.test])
        spent = last + 1 >= self.plan.most_tests
        done = not spent and self._tests.propose() is None
        bound = Bound(None, None, "converged" if done else None)
        return BoundFact(self.name, last, bound, budget=spent, tests=len(fact))

    def seeds(self, first: RolloutId, tests: int, replicates: int) -> list[int]:
        """Return the seed of every rollout of a batch."""
        return rollout_seeds(self._header, first, tests, replicates)

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of a rollout."""
        return rollout_seed(self._header, rollout)

    def findings(self) -> list[tuple[ProblemPlan, SpotFinding]]:
        """Return the finding about every tested bound."""
        return [(plan, _claimed(plan, self._tests.finding(k))) for k, plan in enumerate(self._plans)]

    @property
    def refuted(self) -> bool:
        """Whether it refutes a bound."""
        return any(found.status == "refuted" for _, found in self.findings())

    def _take(self, node: int, values: Sequence[float], rollouts: Sequence[RolloutFact]) -> None:
        """Take the values of a test at a start."""
        width = len(self._plans)
        for first in range(0, len(values), width):
            self._tests.observe(node, values[first : first + width])
        for place, plan in enumerate(self._plans):
            if plan.objective.measured == "gap":
                self._compare(plan, node, values[place::width], rollouts)

    def _compare(self, plan: ProblemPlan, node: int, gaps: Sequence[float], rollouts: Sequence[RolloutFact]) -> None:
        """Compare the gaps of a test with the differences in robustness: those of every pair."""
        found = {(each.rollout.variant, each.rollout.replicate): each.robustness or 0.0 for each in rollouts}
        first = self._first.setdefault(
            node,
            {variant: value for (variant, replicate), value in found.items() if not replicate},
        )
        # A variant without noise has one rollout at a start.
        whole: dict[tuple[str, int], float] = {
            (variant, replicate): found.get((variant, replicate), first[variant])
            for variant in plan.variants
            for replicate in range(len(gaps))
        }
        self.excess = max(self.excess, excess(plan, whole, gaps))

    def _values(self, trajectories: Trajectories) -> tuple[float, ...]:
        """Return J of every tested problem for each replicate."""
        return tuple(
            self._value(plan, trajectories, replicate) for replicate in range(self._replicates) for plan in self._plans
        )

    def _value(self, plan: ProblemPlan, trajectories: Trajectories, replicate: int) -> float:
        used: Trajectories = {
            (variant, 0): trajectories.get((variant, replicate), trajectories[variant, 0]) for variant in plan.variants
        }
        # Algorithm 1 observes a sample risk, which one rollout has not: its mean is not below the risk that is claimed.
        if plan.objective.risk and plan.problem.method == "paper":
            found = self.observer.robustness(used["true", 0])
            assert found is not None, "a risk is one of the robustness"
            return -found
        value = self.observer.observe(replace(plan, replicates=1), used).y
        low, high = value_range(plan)
        # The paper clips no gap; where the expectation of a gap is at most its bound, so is that of the clipped one.
        return value if low is None or high is None else min(max(value, low), high)


def spot_check_plan(header: Header, plans: Collection[ProblemPlan], name: str = SPOT_CHECK) -> state.Plan | None:
    """Return the tests of the spot check of these problems; None for a campaign that has none, whatever its bounds."""
    config, noisy = header.config, header.spec.noisy
    if not config.spot_check or not all(each.box and each.candidates is not None for each in plans):
        return None
    used = {variant for plan in plans for variant in plan.variants}
    # Replicates of a variant without noise would be copies, and no follow-up tells more of it.
    rollouts = tuple(
        (variant, replicate)
        for variant in ("nominal", "true")
        if variant in used
        for replicate in range(config.spot_replicates if variant in noisy else 1)
    )
    later = tuple((variant, replicate) for variant, replicate in rollouts if variant in noisy)
    followups = config.spot_check_followups if later else 0
    # No more in flight than there are starts: a follow-up without any observation is chosen blindly. Without follow-ups
    # no start depends on an observation; but batches are kept in memory until they are observed.
    window = min(WINDOW, config.spot_check) if followups or config.batch > 1 else config.spot_check
    # Of batches a window of some is all of the first tests: follow-ups in it would be chosen blindly as well.
    apart = followups if config.batch > 1 else 0
    return state.Plan(
        name,
        window,
        config.spot_check + followups - apart,
        rollouts,
        later=(config.spot_check, later) if later else None,
        batch=config.batch,
        block=block_size(config.batch, rollouts, header.spec.numbers),
        followups=apart,
    )


def tested_variant(variants: Iterable[str]) -> str | None:
    """Return the variant whose robustness a spot check reports: the true system where it is simulated; None for none.

    >>> tested_variant(["nominal", "true"])
    'true'
    """
    return max(variants, default=None)


def _is_refuted(account: Account) -> bool:
    return account.last_bound is not None and account.last_bound.stopped_by == "refuted"


def _hypothesis(plan: ProblemPlan, limit: float, noisy: Set[str]) -> Hypothesis:
    """Return what the spot check tests of a problem, with the noise scale that its bound rests on where that helps."""
    (low, high), scale = value_range(plan), plan.noise_per_rollout
    # Beside a range as well: a bet within a wide clip gains nothing against little noise. That of the paper's risk is
    # the scale of a mean less deviations, and not of a rollout.
    of_rollouts = not (plan.objective.risk and plan.problem.method == "paper")
    narrow = low is None or high is None or (of_rollouts and scale <= (high - low) / NARROW)
    return Hypothesis(
        plan.key,
        limit,
        low,
        high,
        noisy=not noisy.isdisjoint(plan.variants),
        scale=scale if narrow and 0.0 < scale < math.inf else None,
    )


def _limit(account: Account) -> float:
    """Return the bound on J that the spot check tests, as the certificate has it; infinite where there is none."""
    upper = account.last_bound.bound.upper if account.last_bound else None
    # Rounded like the claim: the last digits of a bound depend on the threads of BLAS and on the CPU.
    return math.inf if upper is None or math.isinf(upper) else round_up(upper)


def _claimed(plan: ProblemPlan, found: SpotFinding) -> SpotFinding:
    """Return a finding about what is claimed: of listed starts a fresh one between them refutes nothing."""
    return replace(found, status="beyond") if found.status == "refuted" and plan.listed is not None else found


def _uniform_starts(header: Header, plans: list[ProblemPlan], name: str) -> list[tuple[float, ...]]:
    """Return the starts, uniform over the box or its region, parameters in the order of the system."""
    box, count = plans[0].candidates, header.config.spot_check
    if not isinstance(box, Lattice):
        draws = Draws(header, name)
        return [draws.start(number) for number in range(count)]
    low, high = np.array(box.low), np.array(box.high)
    shares = uniform(header, name, range(count), len(low))
    return [tuple(float(v) for v in row) for row in low + shares * (high - low)]

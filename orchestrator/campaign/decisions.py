"""The decisions of a campaign: the next test, the observation of a test and the bound after it, as facts."""

from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

from ...schemas.batch import BatchRequest
from ...schemas.errors import PerfboundError
from ...schemas.ids import RolloutId
from ...schemas.result.block_facts import BlockObservationFact, BlockProposalFact
from ...schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ...schemas.trajectory.batch import Batch
from ...schemas.trajectory.reduced import Scores
from ...schemas.trajectory.trajectory import Trajectory
from ...schemas.values import Proposal
from . import counterexample
from .assumption_tests import Refutation
from .methods import Methods
from .observation import (
    Load,
    Observer,
    Others,
    Score,
    Trajectories,
    is_robustness,
    observed_block,
    observed_scores,
)
from .proposals import proposal_source
from .seeds import rollout_seed, rollout_seeds
from .series import Account, Series


@dataclass(frozen=True, slots=True)
class Follow:
    """Where a campaign that is decided again takes its tests from."""

    test: Callable[[str, int, Proposal, Callable[[Sequence[float]], Proposal | None]], Proposal]
    """(problem, test, the source's proposal, the rival at a given start) -> the proposal to take."""
    block: Callable[[BlockProposalFact, Callable[[int, Sequence[float]], Proposal | None]], BlockProposalFact]
    """(the source's proposals, the rival at the start in a place of the block) -> the proposals to take."""


UNOBSERVABLE = "; drop the rollout that is at fault with `perfbound discard`, then resume"
"""The remedy for a test with a recorded rollout that allows no observation."""


class Decider(Protocol):
    """The decisions about one series of tests, called in the order of its facts.

    Every decision depends on the series, on the calls before and on the seed; never on time, worker or file order.
    """

    def proposal(self, series: Series, test: int) -> ProposalFact:
        """Choose the next test."""
        ...

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Turn the trajectories of a test into its observation."""
        ...

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Raise a ValueError if a rollout of an open test allows no observation, alone or with others of the test."""
        ...

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:
        """Take an observation, once, and return the bound after it."""
        ...

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of a rollout of the series."""
        ...


class ProblemDecisions:
    """The decider of one problem: its method and its objective.

    An error of the mathematics becomes a `PerfboundError` that names problem and test.
    """

    def __init__(
        self, account: Account, header: Header, methods: Methods, observer: Observer, follow: Follow | None = None
    ) -> None:
        self._account = account
        self._plan = account.plan
        self._source = proposal_source(account.plan, methods[account.plan.name], header, account.clusters)
        self._header, self._observer, self._follow = header, observer, follow
        self._refutation = Refutation(header, account, methods)

    def proposal(self, series: Series, test: int) -> ProposalFact:
        """Choose the next test of the problem."""
        problem = self._plan.name
        with naming(f"problem {problem}, test {test}"):
            chosen = self._source.propose(series, test)
            if self._follow is not None:
                # In `verify`: another CPU may have broken a tie otherwise, and the rest follows from that one.
                chosen = self._follow.test(problem, test, chosen, partial(self._source.rival, series, test))
        return ProposalFact(problem, test, chosen)

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Turn the trajectories of a test into the value of the objective."""
        problem = self._plan.name
        with naming(f"problem {problem}, test {test}", UNOBSERVABLE):
            found = self._observer.observe(self._plan, trajectories)
        return ObservationFact(problem, test, found, series.next_link(test, found))

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:  # noqa: ARG002
        """Raise a ValueError if a rollout of an open test allows no observation, alone or with others of the test."""
        self._observer.check(self._plan, rollout[2:], trajectory, others)

    @property
    def measured(self) -> Set[str]:
        """What is measured of trajectories, as in `Objective`."""
        return {self._plan.objective.measured}

    @property
    def needs_scores_alone(self) -> bool:
        """Whether an observation follows from the recorded scores of its rollouts."""
        return is_robustness(self._plan)

    def observed_scores(self, series: Series, test: int, rollouts: Sequence[RolloutFact]) -> ObservationFact:
        """Turn the recorded scores of a test into the value of the objective, as `observation` its trajectories."""
        with naming(f"problem {self._plan.name}, test {test}", UNOBSERVABLE):
            found = observed_scores(self._plan, rollouts)
        return ObservationFact(self._plan.name, test, found, series.next_link(test, found))

    def block(self, series: Series, tests: range) -> BlockProposalFact:
        """Choose the next tests of the problem, whose starts no rollout decides."""
        problem = self._plan.name
        with naming(f"problem {problem}, tests {tests.start} to {tests.stop - 1}"):
            chosen = BlockProposalFact.of(problem, tests.start, *self._source.propose_block(series, tests))
            if self._follow is None:
                return chosen
            return self._follow.block(chosen, partial(self._source.rival_in_block, series))

    def observed_block(self, series: Series, test: int, load: Load) -> BlockObservationFact:
        """Turn the rollouts of a block, which begins with `test`, into the values of the objective."""
        proposal, batches = series.blocks[test], series.batches[test]
        with naming(f"problem {self._plan.name}, tests from {test}", UNOBSERVABLE):
            found = observed_block(self._observer, self._plan, len(proposal), batches, load)
        fact = BlockObservationFact.of(self._plan.name, test, *found)
        return replace(fact, chain=series.next_block_link(proposal, batches, fact))

    def bound(self, series: Series, fact: ObservationFact | BlockObservationFact) -> BoundFact:
        """Give an observation to the method, once, and return the bound after it."""
        with naming(f"problem {fact.problem}, test {fact.test}"):
            bound = self._source.observe(series, fact)
        # Verdicts about this test, not events of the loop, so that the speed of the workers decides nothing.
        bound = self._refutation.ended(counterexample.ended(self._header.config, bound, self._account))
        # A method has no budget: its own verdict comes first, also at the last test.
        spent = bound.verdict is None and len(series.observations) >= self._account.budget
        return BoundFact(fact.problem, fact.test + len(fact) - 1, bound, budget=spent, tests=len(fact))

    def seeds(self, first: RolloutId, tests: int, replicates: int) -> list[int]:
        """Return the seed of every rollout of a batch."""
        return rollout_seeds(self._header, first, tests, replicates)

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of a rollout."""
        return rollout_seed(self._header, rollout)


def score(observer: Observer, rollout: RolloutId, trajectory: Trajectory) -> Score:
    """Return what a `RolloutFact` says of a trajectory.

    Raises:
        PerfboundError: it cannot be evaluated; the message names the rollout.

    """
    with naming(f"rollout {rollout}"):
        return observer.score(trajectory)


def scores_of_batch(observer: Observer, request: BatchRequest, batch: Batch) -> Scores:
    """Return what a `BatchFact` says of the trajectories of a batch; one that cannot be scored has failed."""
    with naming(f"batch {request.rollout}"):
        return observer.scores_of(batch)


@contextmanager
def naming(name: str, remedy: str = "") -> Iterator[None]:
    """Turn an error of the mathematics into a `PerfboundError` that names the place."""
    try:
        yield
    except (ValueError, OverflowError) as error:
        raise PerfboundError(f"{name}: {error}{remedy}") from None

"""The decisions of a campaign: the next test, the observation of a test and the bound after it, as facts."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from ...schemas.errors import PerfboundError
from ...schemas.facts import BoundFact, Header, ObservationFact, ProposalFact
from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory
from ...schemas.values import Proposal
from .account import Account
from .methods import Methods
from .observation import Observer, Trajectories
from .seeds import first_node

Follow = Callable[[str, int, Proposal, Callable[[Sequence[float]], Proposal | None]], Proposal]
"""(problem, test, the method's proposal, the rival at a given start) -> the proposal to take."""


class Decisions:
    """The methods and objectives of a campaign, called in the order of the facts.

    Every decision depends on the account that it is given, on the calls before and on the seed; never on time, worker
    or file. An error of the mathematics becomes a `PerfboundError` that names problem and test.
    """

    def __init__(self, header: Header, methods: Methods, follow: Follow | None = None) -> None:
        self._header = header
        self._methods = methods
        self._observer = Observer(header.config, header.spec)
        self._follow = follow

    def proposal(self, account: Account, test: int) -> ProposalFact:
        """Choose the next test of a problem."""
        problem = account.plan.name
        method = self._methods[problem]
        # Tests in flight: a method counts them as observed, so that a window > 1 does not repeat one start.
        pending = [fact.proposal.node for fact in account.proposals.values()]
        first = first_node(self._header, problem, method.size) if test == 0 else None
        with _naming(f"problem {problem}, test {test}"):
            chosen = method.propose(first, pending)
            if self._follow is not None:
                # The first test is drawn by the seed alone: it has no rival.
                chosen = self._follow(problem, test, chosen, lambda x: method.rival(x, pending) if test else None)
        return ProposalFact(problem, test, chosen)

    def robustness(self, rollout: RolloutId, trajectory: Trajectory) -> float | None:
        """Return the robustness of a rollout as the claims read it; None for a campaign that measures none."""
        with _naming(f"rollout {rollout}"):
            return self._observer.robustness(trajectory)

    def observation(self, account: Account, test: int, trajectories: Trajectories) -> ObservationFact:
        """Turn the trajectories of a test into its observation."""
        problem = account.plan.name
        with _naming(f"problem {problem}, test {test}"):
            found = self._observer.observe(account.plan, trajectories)
        return ObservationFact(problem, test, found, account.next_link(test, found))

    def bound(self, account: Account, fact: ObservationFact) -> BoundFact:
        """Give an observation to the method of its problem, once, and return the bound after it."""
        assert account.last_proposal is not None
        with _naming(f"problem {fact.problem}, test {fact.test}"):
            bound = self._methods[fact.problem].observe(account.last_proposal, fact.observation)
        # A method has no budget: its own verdict comes first, also at the last test.
        spent = bound.verdict is None and fact.test + 1 >= account.plan.budget
        return BoundFact(fact.problem, fact.test, bound, budget=spent)


@contextmanager
def _naming(name: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise PerfboundError(f"{name}: {error}") from None

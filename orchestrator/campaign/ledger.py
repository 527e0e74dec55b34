"""The ledger: facts are drawn here, the campaign machine is stepped, and the methods are asked for numbers.

Every fact takes one way, live and in a replay: `_apply`. Live, it is written to the store first.
"""

import math
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, MutableSequence, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ...schemas.campaign import CampaignConfig
from ...schemas.errors import IllegalEvent, JournalError, PerfboundError
from ...schemas.facts import BoundFact, Fact, ObservationFact, ProposalFact, RolloutFact, first_link, next_link
from ...schemas.ids import RolloutId
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory import Trajectory, decode
from ...schemas.values import Bound, Observation, ProblemProgress, Proposal
from ..store import files as evidence
from . import forecast, objectives, state
from .methods import methods
from .observation import Observer
from .plan import ProblemPlan, plans
from .ports import FactStore, FileStore
from .restoration import Restoration
from .seeds import first_node, rollout_seed

ROUND_OFF = 1e-9
"""A bound recomputed on another CPU may differ by less."""

Follow = Callable[[str, int, Proposal, Callable[[Sequence[float]], Proposal | None]], Proposal]
"""(problem, test, the method's proposal, the rival at a given start) -> the proposal to take."""


@dataclass(slots=True)
class Work:
    """The rollouts that are to be simulated from now on, and those that no longer are."""

    wanted: list[RolloutId] = field(default_factory=list)
    unwanted: list[RolloutId] = field(default_factory=list)


@dataclass(slots=True)
class Account:
    """The sums over the closed tests of one problem, and its open tests by number."""

    plan: ProblemPlan
    link: str
    proposals: dict[int, ProposalFact] = field(default_factory=dict)
    rollouts: dict[int, list[RolloutFact]] = field(default_factory=dict)
    observations: MutableSequence[float] = field(default_factory=lambda: array("d"))
    each: list[tuple[float, ...]] = field(default_factory=list)
    nodes: list[int] = field(default_factory=list)
    excess: float = -math.inf
    """Of a gap: the most by which a robustness differed beyond L times the gap; above 0 it dominates nothing."""
    robustness: MutableSequence[float] = field(default_factory=lambda: array("d"))
    counts: dict[str, int] = field(default_factory=lambda: {"nominal": 0, "true": 0})
    last_proposal: Proposal | None = None
    last_bound: BoundFact | None = None

    @property
    def progress(self) -> ProblemProgress:
        """The state of the problem, for people."""
        last, proposal = self.last_bound, self.last_proposal
        return ProblemProgress(
            len(self.observations),
            sum(self.counts.values()),
            proposal.F if proposal and last else None,
            last.bound if last else None,
            last.stopped_by if last else None,
        )


class Ledger:
    """The campaign of one run directory."""

    def __init__(
        self, directory: Path, store: FactStore, *, files: FileStore | None = None, follow: Follow | None = None
    ) -> None:
        """Begin with no fact; `follow` takes the place of the methods' choice where a campaign is decided again."""
        self.header = header = store.header
        self.config: CampaignConfig = header.config
        self.plans = plans(header.config, header.spec)
        self.methods = methods(self.plans)
        self.accounts = {name: Account(plan, first_link(header, name)) for name, plan in self.plans.items()}
        self.state = state.initial(
            tuple(state.Plan(name, each.window, each.budget, each.rollouts) for name, each in self.plans.items())
        )
        self._directory, self._store = directory, store
        self._files: FileStore = files or evidence.Batch()
        self._follow = follow
        self._observer = Observer(header.config, header.spec)
        self._template = header.template
        self._restoration = Restoration(directory)
        self._trajectories: dict[RolloutId, Trajectory] = {}
        self._requests: dict[RolloutId, RolloutRequest] = {}
        self._recomputed: dict[str, BoundFact] = {}

    @property
    def done(self) -> bool:
        """Whether every problem has stopped, and all evidence is there."""
        return self.state.done and not self._restoration

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make everything inside durable together, files before facts, or nothing of it."""
        with self._store.transaction(), self._files:
            yield

    def replay(self) -> None:
        """Rebuild everything from the facts.

        Raises:
            JournalError: the facts are not those that were written.

        """
        try:
            for fact in self._store.facts():
                self._apply(fact)
            if any(len(self.accounts[each.plan.problem].observations) != each.observed for each in self.state.problems):
                raise IllegalEvent("an observation without its bound")
        except (IllegalEvent, KeyError) as error:
            raise JournalError(
                f"{self._directory}: the facts contradict each other ({error}); restore the database from a copy"
            ) from None

    def warnings(self) -> list[str]:
        """Return a line for every problem whose budget cannot reach its tolerance."""
        found = (forecast.out_of_reach(plan) for plan in self.plans.values())
        return [line for line in found if line is not None]

    def check_files(self) -> int:
        """Find files that a crash of the machine damaged, after a replay; return how many are simulated again."""
        self._restoration = Restoration(self._directory, self._store)
        return len(self._restoration)

    def outstanding(self) -> Work:
        """Return the work at the start or after a replay; inside a transaction."""
        if self._restoration:  # before anything else: the facts rest on these files
            return Work(wanted=self._restoration.wanted)
        return self._advance(state.outstanding(self.state))

    def request(self, rollout: RolloutId) -> RolloutRequest:
        """Return the request for an open or a damaged rollout."""
        found = self._requests.get(rollout)
        if found is None:  # needed when it is assigned, and when its result is admitted
            seed = rollout_seed(self.config, rollout)
            found = self._requests[rollout] = self._template.request(rollout, self._start(rollout), seed)
        return found

    def restores(self, rollout: RolloutId) -> bool:
        """Whether this rollout has been recorded, and only its file is wanted again."""
        return rollout in self._restoration

    def record(self, rollout: RolloutId, payload: bytes, trajectory: Trajectory, sha256: str) -> Work:
        """Make an admitted result durable and draw its consequences; inside a transaction.

        Raises:
            PerfboundError: the mathematics cannot go on (singular kernel matrix).
            OSError: the disk is full.

        """
        if rollout in self._restoration:
            self._restoration.restore(rollout, payload, sha256, self._files)
            self._requests.pop(rollout, None)
            return Work() if self._restoration else self.outstanding()
        try:
            robustness = self._observer.robustness(trajectory)
        except ValueError as error:
            raise PerfboundError(f"rollout {rollout}: {error}") from None
        path = evidence.relative_path(rollout)
        self._files.write(self._directory / path, payload)
        self._trajectories[rollout] = trajectory
        seed = self.request(rollout).seed
        del self._requests[rollout]
        return self._advance(self._write(RolloutFact(rollout, seed, sha256, len(payload), path, robustness)))

    def _start(self, rollout: RolloutId) -> tuple[float, ...]:
        fact = self.accounts[rollout.problem].proposals.get(rollout.test)
        return fact.proposal.x if fact else self._restoration.start(rollout)

    def _advance(self, actions: Iterable[state.Action]) -> Work:
        work, pending = Work(), deque(actions)
        while pending:
            match pending.popleft():
                case state.Propose(problem, test):
                    pending.extend(self._write(self._propose(problem, test)))
                case state.Observe(problem, test):
                    pending.extend(self._observe(problem, test))
                case state.Simulate(rollouts):
                    work.wanted += rollouts
                case state.Withdraw(rollouts):
                    work.unwanted += rollouts
                    for rollout in rollouts:
                        self._requests.pop(rollout, None)
                case state.Certify():
                    pass  # `done` says so
        return work

    def _propose(self, problem: str, test: int) -> ProposalFact:
        method = self.methods[problem]
        pending = [fact.proposal.node for fact in self.accounts[problem].proposals.values()]
        first = first_node(self.config, problem, method.size) if test == 0 else None
        try:
            chosen = method.propose(first, pending)
            if self._follow is not None:
                # The first test is drawn by the seed alone: it has no rival.
                chosen = self._follow(problem, test, chosen, lambda x: method.rival(x, pending) if test else None)
        except ValueError as error:
            raise PerfboundError(f"problem {problem}, test {test}: {error}") from None
        return ProposalFact(problem, test, chosen)

    def _observe(self, problem: str, test: int) -> tuple[state.Action, ...]:
        account = self.accounts[problem]
        facts = sorted(account.rollouts[test], key=lambda fact: fact.rollout)
        trajectories = {(f.rollout.variant, f.rollout.replicate): self._trajectory(f) for f in facts}
        try:
            found = self._observer.observe(account.plan, trajectories)
        except ValueError as error:
            raise PerfboundError(f"problem {problem}, test {test}: {error}") from None
        link = next_link(account.link, account.proposals[test], facts, found)
        self._write(ObservationFact(problem, test, found, link))
        return self._write(self._bound(account, test, found))

    def _bound(self, account: Account, test: int, found: Observation) -> BoundFact:
        assert account.last_proposal is not None
        name = account.plan.name
        try:
            bound = self.methods[name].observe(account.last_proposal, found)
        except ValueError as error:
            raise PerfboundError(f"problem {name}, test {test}: {error}") from None
        return BoundFact(name, test, bound, budget=bound.verdict is None and test + 1 >= account.plan.budget)

    def _trajectory(self, fact: RolloutFact) -> Trajectory:
        kept = self._trajectories.pop(fact.rollout, None)
        return kept or decode(evidence.read(self._directory, fact.path, fact.sha256))

    def _write(self, fact: Fact) -> tuple[state.Action, ...]:
        self._store.add(fact)
        return self._apply(fact, live=True)

    def _apply(self, fact: Fact, *, live: bool = False) -> tuple[state.Action, ...]:
        match fact:
            case ProposalFact():
                self.accounts[fact.problem].proposals[fact.test] = fact
                return self._step(state.Proposed(fact.problem, fact.test))
            case RolloutFact():
                account = self.accounts[fact.rollout.problem]
                account.rollouts.setdefault(fact.rollout.test, []).append(fact)
                return self._step(state.Recorded(fact.rollout))
            case ObservationFact():
                self._close(fact, live=live)
                return ()
            case BoundFact():
                if not live:
                    self._compare(fact)
                self.accounts[fact.problem].last_bound = fact
                return self._step(state.Observed(fact.problem, fact.test, fact.bound.verdict))

    def _close(self, fact: ObservationFact, *, live: bool) -> None:
        """Move an observed test from the open ones into the sums."""
        account, found = self.accounts[fact.problem], fact.observation
        proposal, rollouts = account.proposals.pop(fact.test), account.rollouts.pop(fact.test, [])
        if next_link(account.link, proposal, rollouts, found) != fact.chain:
            raise JournalError(
                f"{self._directory}: the facts of test {fact.test} of {fact.problem} were changed after they were "
                "written (hash chain); restore the database from a copy"
            )
        account.link, account.last_proposal = fact.chain, proposal.proposal
        account.observations.append(found.y)
        account.each.append(found.each)
        account.nodes.append(proposal.proposal.node)
        if fact.problem == "sim_gap":
            robustness = {(each.rollout.variant, each.rollout.replicate): each.robustness or 0.0 for each in rollouts}
            account.excess = max(account.excess, objectives.excess(account.plan, robustness, found.each))
        for rollout in rollouts:
            account.counts[rollout.rollout.variant] += 1
            if rollout.robustness is not None:
                account.robustness.append(rollout.robustness)
        if not live:
            self._recomputed[fact.problem] = self._bound(account, fact.test, found)

    def _compare(self, fact: BoundFact) -> None:
        """Refuse a bound that does not follow from the observations before it."""
        ours = self._recomputed[fact.problem]
        if ours.stopped_by != fact.stopped_by or not _close(ours.bound, fact.bound):
            raise JournalError(
                f"{self._directory}: the bound after test {fact.test} of {fact.problem} is not the one that follows "
                "from the observations; restore the database from a copy"
            )

    def _step(self, event: state.Event) -> tuple[state.Action, ...]:
        self.state, actions = state.step(self.state, event)
        return actions


def _close(ours: Bound, stored: Bound) -> bool:
    pairs = ((ours.upper, stored.upper), (ours.lower, stored.lower))
    return all(a is b if a is None or b is None else a == b or abs(a - b) <= ROUND_OFF for a, b in pairs)

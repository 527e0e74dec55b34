"""What the campaign knows: facts are written here, the campaign core is stepped, numbers are asked for.

Every fact takes one way, live and in a replay: `_apply`. Live, it is written to the journal first.
"""

import hashlib
import math
from array import array
from collections import deque
from collections.abc import Iterable, Iterator, MutableSequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from orchestrator import campaign, forecast
from orchestrator.campaign import RolloutId
from orchestrator.errors import EvidenceError, IllegalEvent, JournalError, PerfboundError, RequestError
from orchestrator.methods import budget, noise_per_test
from orchestrator.observation import Observation, Observer, shared
from orchestrator.proposer import Proposer
from orchestrator.requests import request
from orchestrator.store import evidence
from orchestrator.store.journal import (
    BoundFact,
    Fact,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    first_link,
    next_link,
)
from orchestrator.store.ports import Book, Shelf
from schemas.base import canonical_json
from schemas.campaign import ROLLED_OUT, CampaignConfig, Problem, RigorousProblem
from schemas.rollout import RolloutRequest
from schemas.system import SystemSpec
from schemas.trajectory import Trajectory, TrajectoryError, decode, read

ROUND_OFF = 1e-9
"""A bound recomputed on another CPU may differ by less."""
SAMPLES = 50
"""The last sample is before the horizon by a step, and by a part of it that is this small, at most."""


@dataclass(slots=True)
class Work:
    """What the dispatch core is to be told."""

    wanted: list[RolloutId] = field(default_factory=list)
    unwanted: list[RolloutId] = field(default_factory=list)


@dataclass(slots=True)
class Account:
    """What is known of one problem; open tests by number."""

    problem: Problem
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
    last_proposal: ProposalFact | None = None
    last_bound: BoundFact | None = None


class Ledger:
    """The campaign of one run directory."""

    def __init__(
        self, directory: Path, journal: Book, *, files: Shelf | None = None, proposer: Proposer | None = None
    ) -> None:
        header = journal.header
        self.header = header
        self.config: CampaignConfig = header.config
        self.accounts: dict[str, Account] = {
            problem.name: Account(problem, first_link(header, problem.name)) for problem in self.config.problems
        }
        plans = (plan(self.config, header.spec, problem) for problem in self.config.problems)
        self.state = campaign.initial(tuple(plans))
        self._directory = directory
        self._journal = journal
        self._observer = Observer(self.config, header.spec)
        self.proposer = proposer or Proposer(self.config, header.spec)
        self._files: Shelf = files or evidence.Batch()
        self._damaged: dict[RolloutId, RolloutFact] = {}
        self._closed: dict[tuple[str, int], ProposalFact] = {}
        self._trajectories: dict[RolloutId, Trajectory] = {}
        self._requests: dict[RolloutId, RolloutRequest] = {}
        self._recomputed: dict[str, BoundFact] = {}

    @property
    def done(self) -> bool:
        """Whether every problem has stopped, and all evidence is there."""
        return self.state.done and not self._damaged

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make everything inside durable together, files before facts, or nothing of it."""
        with self._journal.transaction(), self._files:
            yield

    def replay(self) -> None:
        """Rebuild everything from the journal.

        Raises:
            JournalError: the facts are not what was written.

        """
        try:
            for fact in self._journal.facts():
                self._apply(fact)
            if any(len(self.accounts[each.plan.problem].observations) != each.observed for each in self.state.problems):
                raise IllegalEvent("an observation without its bound")
        except (IllegalEvent, KeyError) as error:
            raise JournalError(
                f"{self._directory}: the facts contradict each other ({error}); restore the database from a copy"
            ) from None

    def warnings(self) -> list[str]:
        """Return what is to be said at the start: problems whose budget cannot reach their tolerance."""
        config, spec = self.config, self.header.spec
        found = [
            forecast.out_of_reach(config, problem, noise_per_test(config, spec, problem))
            for problem in config.problems
            if isinstance(problem, RigorousProblem)
        ]
        return [line for line in found if line is not None]

    def mend(self) -> int:
        """Look for evidence that a crash of the machine spoiled, and remove what no fact knows; after a replay.

        What is damaged is simulated again before anything else: the same seed gives the same file. Returns how many.
        """
        facts = self._journal.recorded()
        evidence.sweep(self._directory, {fact.path for fact in facts})
        paths = set(evidence.damaged(self._directory, ((fact.path, fact.size, fact.sha256) for fact in facts)))
        self._damaged = {fact.rollout: fact for fact in facts if fact.path in paths}
        tests = {rollout[:2] for rollout in self._damaged}
        self._closed = {test: self._journal.proposal(*test) for test in tests}
        return len(self._damaged)

    def outstanding(self) -> Work:
        """Return what is to be done at the start or after a replay; inside a transaction."""
        if self._damaged:
            return Work(wanted=sorted(self._damaged))
        return self._advance(campaign.outstanding(self.state))

    def record(self, rollout: RolloutId, payload: bytes, trajectory: Trajectory, sha256: str | None = None) -> Work:
        """Make a result durable and draw its consequences; inside a transaction.

        `sha256` is the digest of the payload, for a caller that has computed it already.

        Raises:
            PerfboundError: the mathematics cannot go on (singular kernel matrix).
            OSError: the disk is full.

        """
        sha256 = sha256 or hashlib.sha256(payload).hexdigest()
        if rollout in self._damaged:
            return self._restore(rollout, payload, sha256)
        try:
            robustness = self._observer.robustness(trajectory)
        except ValueError as error:
            raise PerfboundError(f"rollout {rollout}: {error}") from None
        path = evidence.relative_path(rollout)
        self._files.write(self._directory / path, payload)
        self._trajectories[rollout] = trajectory
        fact = RolloutFact(
            rollout,
            seed=self.request(rollout).seed,
            sha256=sha256,
            size=len(payload),
            path=path,
            robustness=robustness,
        )
        del self._requests[rollout]
        return self._advance(self._write(fact))

    def trajectory(self, rollout: RolloutId, payload: bytes) -> Trajectory:
        """Return the trajectory in the file of an open rollout.

        Raises:
            RequestError: it is of another request.
            EvidenceError: it is no trajectory, has other columns, or is not from 0 to the horizon.

        """
        try:
            file = read(payload)
        except TrajectoryError as fault:
            raise EvidenceError(f"the result is not a trajectory: {fault}") from None
        request = self.request(rollout)
        wanted = request.model_dump(mode="json")
        if canonical_json(file.request) != canonical_json(wanted):  # 1, 1.0 and true are equal in Python
            differing = sorted(key for key in file.request | wanted if file.request.get(key) != wanted.get(key))
            names = ", ".join(differing)[:200]
            raise RequestError(f"the trajectory was simulated for another request (other {names})")
        self._check_whole(file.trajectory)
        if {**file.metadata, "columns": ""} != {**request.metadata, "columns": ""}:
            raise RequestError("the metadata of the trajectory name another rollout")
        return file.trajectory

    def _check_whole(self, trajectory: Trajectory) -> None:
        """Refuse what is cut: robustness of less than the horizon is robustness of something else."""
        if trajectory.columns != tuple(column.name for column in self.header.spec.columns):
            raise EvidenceError(f"the trajectory has the columns {', '.join(trajectory.columns)[:200]}")
        t, horizon = trajectory.samples[:, 0], self.config.horizon
        step = min(float(np.max(np.diff(t), initial=0.0)), horizon / SAMPLES)
        if t[0] > ROUND_OFF or not horizon - step - ROUND_OFF <= t[-1] <= horizon + ROUND_OFF:
            span = f"{t[0]:g} to {t[-1]:g} s"
            raise EvidenceError(f"the trajectory goes from {span}, the campaign asks for 0 to {horizon:g} s")

    def request(self, rollout: RolloutId) -> RolloutRequest:
        """Return everything that a worker needs to know of an open rollout."""
        found = self._requests.get(rollout)
        if found is None:  # asked for when it is assigned, and when its result is checked
            found = self._requests[rollout] = request(self.header, rollout, self._proposal(rollout).x)
        return found

    def restores(self, rollout: RolloutId) -> bool:
        """Whether this rollout has been recorded, and only its file is wanted again."""
        return rollout in self._damaged

    def _restore(self, rollout: RolloutId, payload: bytes, sha256: str) -> Work:
        """Put a damaged file back."""
        fact = self._damaged[rollout]
        if sha256 != fact.sha256:
            raise PerfboundError(
                f"{self._directory / fact.path}: damaged, and simulated again it has the sha256 {sha256[:12]}..., not "
                f"the recorded {fact.sha256[:12]}...: this machine computes other digits. Restore it from a copy"
            )
        self._files.write(self._directory / fact.path, payload)
        del self._damaged[rollout]
        self._requests.pop(rollout, None)
        return Work() if self._damaged else self.outstanding()

    def _proposal(self, rollout: RolloutId) -> ProposalFact:
        found = self.accounts[rollout.problem].proposals.get(rollout.test)
        return found or self._closed[rollout.problem, rollout.test]

    def _advance(self, actions: Iterable[campaign.Action]) -> Work:
        work, pending = Work(), deque(actions)
        while pending:
            match pending.popleft():
                case campaign.Propose(problem, test):
                    pending.extend(self._write(self._propose(problem, test)))
                case campaign.Observe(problem, test):
                    pending.extend(self._observe(problem, test))
                case campaign.Simulate(rollouts):
                    work.wanted += rollouts
                case campaign.Withdraw(rollouts):
                    work.unwanted += rollouts
                    for rollout in rollouts:
                        self._requests.pop(rollout, None)
                case campaign.Certify():
                    pass  # `done` says so
        return work

    def _propose(self, problem: str, test: int) -> ProposalFact:
        try:
            pending = [proposal.node for proposal in self.accounts[problem].proposals.values()]
            return self.proposer.propose(problem, test, pending)
        except ValueError as error:
            raise PerfboundError(f"problem {problem}, test {test}: {error}") from None

    def _observe(self, problem: str, test: int) -> tuple[campaign.Action, ...]:
        account = self.accounts[problem]
        facts = sorted(account.rollouts[test], key=lambda fact: fact.rollout)
        trajectories = {(f.rollout.variant, f.rollout.replicate): self._trajectory(f) for f in facts}
        try:
            found = self._observer.observe(account.problem, trajectories)
        except ValueError as error:
            raise PerfboundError(f"problem {problem}, test {test}: {error}") from None
        link = next_link(account.link, account.proposals[test], facts, found.y, found.each)
        self._write(ObservationFact(problem, test, found.y, found.each, link))
        return self._write(self._bound(account, test, found))

    def _bound(self, account: Account, test: int, found: Observation) -> BoundFact:
        last = test + 1 >= budget(self.config, self.header.spec, account.problem)
        assert account.last_proposal is not None
        try:
            return self.proposer.observe(account.last_proposal, found, last=last)
        except ValueError as error:
            raise PerfboundError(f"problem {account.problem.name}, test {test}: {error}") from None

    def _trajectory(self, fact: RolloutFact) -> Trajectory:
        kept = self._trajectories.pop(fact.rollout, None)
        return kept or decode(evidence.read(self._directory, fact.path, fact.sha256))

    def _write(self, fact: Fact) -> tuple[campaign.Action, ...]:
        self._journal.add(fact)
        return self._apply(fact, live=True)

    def _apply(self, fact: Fact, *, live: bool = False) -> tuple[campaign.Action, ...]:
        match fact:
            case ProposalFact():
                self.accounts[fact.problem].proposals[fact.test] = fact
                return self._step(campaign.Proposed(fact.problem, fact.test))
            case RolloutFact():
                account = self.accounts[fact.rollout.problem]
                account.rollouts.setdefault(fact.rollout.test, []).append(fact)
                return self._step(campaign.Recorded(fact.rollout))
            case ObservationFact():
                self._close(fact, live=live)
                return ()
            case BoundFact():
                if not live:
                    self._compare(fact)
                self.accounts[fact.problem].last_bound = fact
                return self._step(campaign.Observed(fact.problem, fact.test, _verdict(fact)))

    def _close(self, fact: ObservationFact, *, live: bool) -> None:
        """Move an observed test from the open ones into the sums."""
        account = self.accounts[fact.problem]
        proposal, rollouts = account.proposals.pop(fact.test), account.rollouts.pop(fact.test, [])
        if next_link(account.link, proposal, rollouts, fact.y, fact.each) != fact.chain:
            raise JournalError(
                f"{self._directory}: the facts of test {fact.test} of {fact.problem} were changed after they were "
                "written (hash chain); restore the database from a copy"
            )
        account.link, account.last_proposal = fact.chain, proposal
        account.observations.append(fact.y)
        account.each.append(fact.each)
        account.nodes.append(proposal.node)
        if account.problem.name == "sim_gap":
            account.excess = max(account.excess, self._excess(account.problem, rollouts, fact.each))
        for rollout in rollouts:
            account.counts[rollout.rollout.variant] += 1
            if rollout.robustness is not None:
                account.robustness.append(rollout.robustness)
        if not live:
            self._recomputed[fact.problem] = self._bound(account, fact.test, Observation(fact.y, fact.each))

    def _excess(self, problem: Problem, rollouts: list[RolloutFact], gaps: tuple[float, ...]) -> float:
        gap = self.config.gap_of(problem)
        assert gap is not None, "the campaign file was checked"
        found = {(each.rollout.variant, each.rollout.replicate): each.robustness or 0.0 for each in rollouts}
        first = {variant: shared(self.header.spec, problem, variant) for variant in ("nominal", "true")}
        differences = []
        for replicate, value in enumerate(gaps):
            nominal, true = (found[v, 0 if first[v] else replicate] for v in ("nominal", "true"))
            signed = nominal - true if gap.kind == "robustness" else abs(nominal - true)
            differences.append(signed - gap.lipschitz * value)
        return max(differences)

    def _compare(self, fact: BoundFact) -> None:
        """Refuse a bound that does not follow from the observations before it."""
        ours = self._recomputed[fact.problem]
        same = all(_close_to(a, b) for a, b in ((ours.upper, fact.upper), (ours.lower, fact.lower)))
        if ours.stopped_by != fact.stopped_by or not same:
            raise JournalError(
                f"{self._directory}: the bound after test {fact.test} of {fact.problem} is not the one that follows "
                "from the observations; restore the database from a copy"
            )

    def _step(self, event: campaign.Event) -> tuple[campaign.Action, ...]:
        self.state, actions = campaign.step(self.state, event)
        return actions


def _verdict(fact: BoundFact) -> Literal["converged", "refuted"] | None:
    return None if fact.stopped_by == "budget" else fact.stopped_by


def _close_to(a: float | None, b: float | None) -> bool:
    return a is b if a is None or b is None else a == b or abs(a - b) <= ROUND_OFF


def plan(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> campaign.Plan:
    """Return what is fixed about a problem before its first test."""
    rollouts = tuple(
        (variant, replicate)
        for replicate in range(config.replicates_of(problem))
        for variant in ROLLED_OUT[problem.name]
        if replicate == 0 or not shared(spec, problem, variant)
    )
    return campaign.Plan(problem.name, config.window_of(problem), budget(config, spec, problem), rollouts)

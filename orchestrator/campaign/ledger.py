"""The ledger: the facts of a campaign, the step of the campaign machine after each, and the questions that follow.

Every fact takes one way, live, in a replay and in `verify`: `_apply`. Live, it is written to the store first.
"""

import hashlib
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...schemas.batch import BatchRequest, file_of
from ...schemas.errors import EvidenceError, IllegalEvent, JournalError, one_line, shortened
from ...schemas.file.config import CampaignConfig
from ...schemas.ids import FileId, RolloutId, WorkId, first_of
from ...schemas.ranges import DIGEST
from ...schemas.result.block_facts import (
    BatchFact,
    BlockObservationFact,
    BlockProposalFact,
    StoredFact,
    column,
)
from ...schemas.result.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    first_link,
)
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.batch import Batch
from ...schemas.trajectory.reduced import Reduced, Scores, encode_reduced, reduced
from ...schemas.trajectory.trajectory import Trajectory
from ..store import files as evidence
from . import state
from .closing.checks import ClosingChecks
from .closing.spot_check import SpotCheck
from .decisions import Decider, Follow, ProblemDecisions, score
from .extension import check_extension
from .methods import methods
from .observation import Observer
from .plan import plans
from .ports import FactStore, FileStore, Recorded, RecordedRollouts
from .proposals import failure_clusters
from .restoration import Restoration
from .series import Account, Kept, Series


@dataclass(slots=True)
class Work:
    """The rollouts that are to be simulated from now on, and those that no longer are."""

    wanted: list[RolloutId] = field(default_factory=list)
    unwanted: list[RolloutId] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Scored:
    """An admitted batch, with its scores."""

    batch: Batch | Reduced
    scores: Scores

    @property
    def rollouts(self) -> int:
        """The number of those that have a trajectory."""
        return len(self.batch) - len(self.scores.failures)


class Ledger:
    """The campaign of one run directory; use from one thread, and write inside `transaction` only."""

    def __init__(
        self,
        directory: Path,
        store: FactStore,
        *,
        files: FileStore | None = None,
        follow: Follow | None = None,
    ) -> None:
        """Begin with no fact; of a campaign that is decided again `follow` has the tests."""
        self.header = header = store.header
        self.config: CampaignConfig = header.config
        self.plans = plans(header.config, header.spec)
        self.methods = methods(self.plans, header)
        # A hash chain for each problem, over its observations: one in the order of arrival would depend on the workers.
        self.accounts = {
            name: Account(
                first_link(header, name),
                plan=plan,
                kept=Kept(header.config.keep),
                clusters=failure_clusters(plan, header),
            )
            for name, plan in self.plans.items()
        }
        self.extensions: list[ExtensionFact] = []
        self.series: dict[str, Series] = dict(self.accounts)
        """The accounts of the problems, then the closing checks that have begun."""
        self.state = state.initial(tuple(each.machine for each in self.plans.values()))
        self.observer = Observer(header.config, header.spec)
        self.deciders: dict[str, Decider] = {
            name: ProblemDecisions(account, header, self.methods, self.observer, follow)
            for name, account in self.accounts.items()
        }
        self._directory, self._store = directory, store
        self.recorded = Recorded(directory, store)
        self.closing = ClosingChecks(header, self.accounts, self.methods, self.observer, self.recorded)
        self._files: FileStore = files or evidence.Batch()
        self._template, self._restoration = header.template, Restoration(directory)
        self._requests: dict[RolloutId, RolloutRequest | BatchRequest] = {}
        self.arrived = 0
        """Rollouts with a trajectory that `record` has taken; a replay has none."""
        self.received = 0
        """Bytes of their files, as workers sent them."""

    @property
    def done(self) -> bool:
        """Whether every problem has stopped, and all evidence is there."""
        return self.state.done and not self._restoration

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Make everything inside durable together, or nothing of it."""
        # Files first: a file without its fact is swept at the next resume, a fact without its file is a lost rollout.
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
            # Both are written in one transaction, so no crash leaves one of them.
            if any(series.due for series in self.series.values()):
                raise IllegalEvent("an observation without its bound")
        # Not IllegalEvent alone: the facts are what a disk has left of them.
        except (ValueError, LookupError, ArithmeticError, TypeError, AttributeError, AssertionError) as error:
            raise JournalError(
                f"{self._directory}: the facts contradict each other ({one_line(str(error))[:300]}); "
                "restore the database from a copy"
            ) from None

    def check_files(self, recorded: RecordedRollouts, *, whole: bool = False) -> int:
        """Find files that are missing or damaged; return how many are simulated again.

        After a replay those that a crash of the machine may have damaged; `whole` before the certificate, each one.
        """
        # The kept files of discarded rollouts have no row in `rollouts`, and would be swept.
        discarded = [fact.path for series in self.series.values() for fact in series.discards]
        self._restoration = Restoration(self._directory, recorded, discarded=discarded, whole=whole)
        return len(self._restoration)

    def outstanding(self) -> Work:
        """Return the work at the start or after a replay; inside a transaction."""
        if self._restoration:  # before anything else: the facts rest on these files
            return Work(wanted=self._restoration.wanted)
        return self._advance(state.outstanding(self.state))

    def extend(self, fact: ExtensionFact) -> Work:
        """Make an extension durable and draw its consequences; inside a transaction.

        Raises:
            IllegalEvent: it is not the one of a campaign that is done.

        """
        return self._advance(self._write(fact))

    def request(self, rollout: RolloutId) -> RolloutRequest | BatchRequest:
        """Return the request for an open or a damaged rollout, or for the batch that it names."""
        found = self._requests.get(rollout)
        if found is None:  # kept: needed when it is assigned, and when its result is admitted
            found = self._requests[rollout] = self._requested(rollout)
        return found

    def _requested(self, rollout: RolloutId) -> RolloutRequest | BatchRequest:
        if (damaged := self._restoration.batch(rollout)) is not None:
            return self._template.batch(rollout, self._restoration.starts(damaged), damaged.seeds.tolist())
        series, plan = self.series[rollout.problem], state.plan_of(self.state, rollout.problem)
        if plan.batch == 1 or rollout in self._restoration:
            fact = series.proposals.get(rollout.test)
            # A damaged file may belong to a closed test, of which the series keeps sums alone.
            return self._alone(rollout, fact.proposal.x if fact else self._restoration.start(rollout))
        first, tests, replicates = plan.batch_of(rollout)
        if first != rollout or series.has_begun(
            first, replicates
        ):  # it has failed in its batch, and is made again alone
            tests = replicates = 1
        starts = series.starts(rollout.test, tests)
        seeds = self.batched(rollout.problem).seeds(rollout, tests, replicates)
        return self._template.batch(rollout, starts, seeds)

    def _alone(self, rollout: RolloutId, start: Sequence[float]) -> RolloutRequest:
        original = self.closing.original(rollout)
        within = None if original is None else self.recorded.within(original)
        return self._template.request(rollout, start, self.deciders[rollout.problem].seed(rollout), within=within)

    def request_again(self, work: WorkId) -> RolloutRequest | BatchRequest:
        """Return the request for a rollout or a batch of any test, which may be closed; in or outside a transaction."""
        first = first_of(work)
        if not isinstance(work, FileId):
            return self._alone(first, self.recorded.start(first))
        replicates = min(work.places, state.plan_of(self.state, first.problem).replicates_of(first))
        tests = work.places // replicates
        starts = [self.recorded.start(first._replace(test=first.test + each)) for each in range(tests)]
        seeds = self.batched(first.problem).seeds(first, tests, replicates)
        return self._template.batch(first, starts, seeds)

    def restores(self, rollout: RolloutId) -> bool:
        """Whether this rollout has been recorded, and only its file is wanted again."""
        return rollout in self._restoration

    def record(self, rollout: RolloutId, payload: bytes, found: Trajectory | Scored, sha256: str) -> Work:
        """Make an admitted result durable and draw its consequences; inside a transaction.

        Raises:
            PerfboundError: the mathematics cannot continue (singular kernel matrix).
            OSError: the disk is full.

        """
        request = self.request(rollout)
        del self._requests[rollout]
        self.arrived += found.rollouts if isinstance(found, Scored) else 1
        self.received += len(payload)
        if rollout in self._restoration:
            # No fact: it has been recorded. The campaign continues when the last damaged file is back.
            self._restoration.restore(rollout, payload, self._files)
            if rollout in self._restoration:  # a batch, and its first rollout that was made again
                return Work(wanted=[rollout])
            return Work() if self._restoration else self.outstanding()
        # Before the file: what cannot be scored leaves nothing behind.
        path = evidence.relative_path(file_of(request))
        if isinstance(found, Scored):
            assert isinstance(request, BatchRequest)
            block = state.plan_of(self.state, rollout.problem).batch_of(rollout)[0].test
            if (left := _reduced(self.series[rollout.problem].kept, rollout, block, found)) is not None:
                payload = encode_reduced(left, request=request.model_dump(mode="json"), metadata=request.metadata)
                sha256, found = hashlib.sha256(payload).hexdigest(), replace(found, batch=left)
            fact: RolloutFact | BatchFact = _batch_fact(rollout, block, request, found, (sha256, len(payload), path))
        else:
            assert isinstance(request, RolloutRequest)
            file = (sha256, len(payload), path)
            fact = RolloutFact(rollout, request.seed, *file, **score(self.observer, rollout, found)._asdict())
        self._files.write(evidence.inside(self._directory, path), payload)
        # Its test is observed as soon as the other rollouts of it are there: it is not read back from the disk.
        if not isinstance(found, Scored):
            self.recorded.keep(rollout, found)
        elif isinstance(found.batch, Batch) and not self.batched(rollout.problem).needs_scores_alone:
            assert isinstance(fact, BatchFact)
            self.recorded.keep_batch(fact, found.batch)
        return self._advance(self._write(fact))

    def batched(self, name: str) -> ProblemDecisions | SpotCheck:
        """Return the decider of a series that has batches."""
        found = self.deciders[name]
        assert isinstance(found, ProblemDecisions | SpotCheck), "no other series has batches"
        return found

    def _advance(self, actions: Iterable[state.Action]) -> Work:
        """Carry out actions and those that follow from them, until only simulations are left."""
        work, pending = Work(), deque(actions)
        while pending:
            match pending.popleft():
                case state.Propose(problem, test):
                    pending.extend(self._write(self._proposal(problem, test)))
                case state.Observe(problem, test):
                    pending.extend(self._observe(problem, test))
                case state.Simulate(rollouts):
                    work.wanted += rollouts
                case state.Withdraw(rollouts):
                    work.unwanted += rollouts
                    for rollout in rollouts:
                        self._requests.pop(rollout, None)
                case state.Certify():
                    pass  # `done` is true from here on; the caller issues the certificate
        return work

    def _proposal(self, name: str, test: int) -> ProposalFact | BlockProposalFact:
        plan, series = state.plan_of(self.state, name), self.series[name]
        if plan.block == 1:
            return self.deciders[name].proposal(series, test)
        return self.batched(name).block(series, plan.tests_of(test))

    def _observe(self, name: str, test: int) -> tuple[state.Action, ...]:
        series, decider = self.series[name], self.deciders[name]
        if test in series.blocks:
            batches = series.batches[test]
            self._write(self.batched(name).observed_block(series, test, self.recorded.batch))
            self.recorded.drop(each.sha256 for each in batches)
            assert series.due is not None
            return self._write(series.due)
        # By id: the order of arrival depends on the workers, and an observation must not.
        facts = sorted(series.rollouts[test], key=lambda fact: fact.rollout)
        if self.config.batch > 1 and isinstance(decider, ProblemDecisions) and decider.needs_scores_alone:
            self._write(decider.observed_scores(series, test, facts))
        else:
            trajectories = {fact.rollout[2:]: self.recorded.take(fact) for fact in facts}
            self.recorded.drop({fact.batch for fact in facts})
            self._write(decider.observation(series, test, trajectories))
        assert series.due is not None
        return self._write(series.due)

    def _write(self, fact: StoredFact) -> tuple[state.Action, ...]:
        # Before it is applied: an error there ends the transaction, which takes the row back.
        self._store.add(fact)
        return self._apply(fact)

    def _apply(self, fact: StoredFact) -> tuple[state.Action, ...]:
        event: state.Event
        match fact:
            case BatchFact(rollout):
                series = self.series[rollout.problem]
                series.record(fact)
                event = state.Recorded(rollout, fact.failed)
            case BlockObservationFact(problem):
                series = self.series[problem]
                series.observe_block(fact)
                series.due = self.batched(problem).bound(series, fact)
                return ()
            case ProposalFact(problem, test) | BlockProposalFact(problem, test):
                self.series[problem].propose(fact)
                event = state.Proposed(problem, test)
            case RolloutFact(rollout):
                self.series[rollout.problem].rollouts.setdefault(rollout.test, []).append(fact)
                event = state.Recorded(rollout)
            case DiscardFact(rollout):
                self.series[rollout.problem].discards.append(fact)
                return ()  # its rollout is missing, so that the machine wants it
            case ObservationFact(problem):
                series = self.series[problem]
                series.observe(fact)
                # In a replay as well: the method takes its data here, and a recorded bound is compared with this one.
                series.due = self.deciders[problem].bound(series, fact)
                return ()
            case ExtensionFact(budgets=budgets):
                check_extension(fact, self.accounts, self.closing, len(self.extensions) + 1)
                self.extensions.append(fact)
                self.closing.extend()
                for account in self.accounts.values():
                    account.extend(fact)
                event = state.Extended(budgets)
            case BoundFact(problem, test):
                self.series[problem].bound(fact)
                event = state.Observed(problem, test + 1 - fact.tests, fact.bound.verdict)
        self.state, actions = state.step(self.state, event)
        # The last observation may withdraw rollouts as well: they come before what the check begins with.
        return (*actions[:-1], *self._begin_check()) if state.Certify() in actions else actions

    def _begin_check(self) -> tuple[state.Action, ...]:
        """Begin the next check of a campaign whose series have all stopped; without one it can be certified."""
        found = self.closing.next(self.state, self.series)
        if found is None:
            return (state.Certify(),)
        check, series = found
        self.series[check.name], self.deciders[check.name] = series, check
        self.state, actions = state.with_series(self.state, check.plan)
        return actions


def _reduced(kept: Kept, rollout: RolloutId, block: int, found: Scored) -> Reduced | None:
    """Return a batch as the key `keep` leaves it; None for one that stays whole.

    Raises:
        EvidenceError: it comes reduced, and otherwise.

    """
    margins = found.scores.robustness
    places = None if margins is None else kept.places(block, margins)
    if isinstance(found.batch, Reduced):
        if places is None or found.batch.kept != tuple(places):
            raise EvidenceError(f"the batch of {rollout} has the samples of other rollouts than `keep` leaves")
        return found.batch
    if margins is None or places is None:
        return None
    return reduced(found.batch, places, found.scores)


def _batch_fact(
    rollout: RolloutId, block: int, request: BatchRequest, found: Scored, file: tuple[str, int, str]
) -> BatchFact:
    scores, failures = found.scores, sorted(found.scores.failures.items())
    nothing = bytes(DIGEST)
    digests = [nothing if place in scores.failures else each for place, each in enumerate(found.batch.digests)]
    return BatchFact(
        rollout,
        block,
        request.replicates,
        *file,
        seed_column=column(request.seeds, "<u8"),
        digest_column=b"".join(digests),
        robustness_column=b"" if scores.robustness is None else column(scores.robustness),
        tolerance_column=column(scores.by_tolerance, "?") if scores.by_tolerance.any() else b"",
        ended_column=column(scores.ended) if not np.isnan(scores.ended).all() else b"",
        kept_column=_marks(found.batch) if isinstance(found.batch, Reduced) else b"",
        failures=tuple((place, shortened(reason)) for place, reason in failures),
    )


def _marks(batch: Reduced) -> bytes:
    marks = np.zeros(len(batch), dtype=np.bool_)
    marks[list(batch.kept)] = True
    return column(marks, "?")


def observed_discards(ledger: Ledger) -> list[DiscardFact]:
    """Return the discarded rollouts of the observed tests, in the order of the series, tests and rollouts."""
    found = [
        [fact for fact in series.discards if fact.rollout.test < len(series.observations)]
        for series in ledger.series.values()
    ]
    return [fact for each in found for fact in sorted(each, key=lambda fact: (*fact.rollout[1:], fact.sha256))]


def failed_attempts(ledger: Ledger) -> int:
    """Return the attempts at observed rollouts that failed in the system, as far as the evidence itself shows them.

    A discarded rollout had no objective, and one that failed in its batch is marked there; both were made again.
    """
    return len(observed_discards(ledger)) + sum(series.failed for series in ledger.series.values())


def observed_rollouts(ledger: Ledger) -> int:
    """Return the number of rollouts behind the observations."""
    return sum(sum(series.counts.values()) for series in ledger.series.values())

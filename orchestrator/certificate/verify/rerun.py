"""The rerun of a campaign, with the trajectories of the manifest in place of workers.

The ledger that decided the campaign decides it again: the next test, its observation, the end of a problem. It writes
to memory only. Where the evidence does not fit, `CheckFailed` names the check.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ....schemas.amounts import counted
from ....schemas.batch import BatchRequest, file_of
from ....schemas.errors import EvidenceError, IllegalEvent, PerfboundError, RequestError, TrajectoryError
from ....schemas.ids import FileId, RolloutId
from ....schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact, StoredFact, places
from ....schemas.result.facts import (
    DiscardFact,
    ExtensionFact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from ....schemas.trajectory.reduced import read_stored
from ....schemas.trajectory.trajectory import Trajectory, decode, read_mcap
from ....schemas.values import Proposal
from ...campaign.admission import admit, admit_stored, scored
from ...campaign.decisions import Follow
from ...campaign.ledger import Ledger, Scored, Work
from ...store import files
from .checks import CheckFailed
from .discards import check_discard
from .manifest import Entry


class MemoryFactStore:
    """A fact store in memory; nothing in it survives the process."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self.written: list[StoredFact] = []
        self._rollouts: dict[RolloutId, RolloutFact] = {}
        self._proposals: dict[tuple[str, int], ProposalFact] = {}
        self._batched: dict[RolloutId, BatchFact] = {}
        self._blocks: dict[tuple[str, int], BlockProposalFact] = {}

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Do nothing: there is nothing to make durable."""
        yield

    def add(self, fact: StoredFact) -> None:
        """Append a fact."""
        self.written.append(fact)
        if isinstance(fact, RolloutFact):
            self._rollouts[fact.rollout] = fact
        elif isinstance(fact, ProposalFact):
            self._proposals[fact.problem, fact.test] = fact
        elif isinstance(fact, BatchFact):
            for rollout in fact.rollouts:
                self._batched[rollout] = fact
        elif isinstance(fact, BlockProposalFact):
            for test in range(fact.test, fact.test + len(fact)):
                self._blocks[fact.problem, test] = fact

    def facts(self) -> Iterator[StoredFact]:
        """Yield all facts in their order."""
        return iter(self.written)

    def rollout(self, rollout: RolloutId) -> RolloutFact:
        """Return a recorded rollout."""
        if rollout in self._rollouts:
            return self._rollouts[rollout]
        found = self._batched[rollout].alone(rollout)
        assert found is not None, "another fact has one that failed"
        return found

    def batch_of(self, rollout: RolloutId) -> BatchFact | None:
        """Return the batch of a recorded rollout; None for one without."""
        return None if rollout in self._rollouts else self._batched[rollout]

    def proposal(self, problem: str, test: int) -> ProposalFact:
        """Return the proposal of a test that has one."""
        found = self._proposals.get((problem, test))
        return found or self._blocks[problem, test].of_test(test)


class NullFileStore:
    """A file store that discards every file: the manifest has them all."""

    def write(self, path: Path, data: bytes) -> None:
        """Discard a file."""

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, *_: object) -> None:
        """End."""


class Rerun:
    """One campaign, decided again; `facts` and `ledger` follow from header and evidence alone."""

    def __init__(
        self,
        directory: Path,
        header: Header,
        entries: Mapping[FileId, Entry],
        discards: Sequence[DiscardFact] = (),
        extensions: Sequence[ExtensionFact] = (),
    ) -> None:
        self._extensions = deque(extensions)
        self._directory, self._entries, self._discards = directory, entries, list(discards)
        self._first: dict[tuple[str, int], FileId] = {}
        # The request in the first file of a test has its start; the file must then fit the whole request.
        for file in entries:
            self._first.setdefault(file.rollout[:2], file)
        self._columns = tuple(column.name for column in header.spec.columns)
        self._store = MemoryFactStore(header)
        self.ties = 0
        """Tests for which this machine chooses another one of equal value."""
        # The same ledger, no second implementation: two that disagree in the ninth digit prove nothing about tampering.
        self.ledger = Ledger(
            directory, self._store, files=NullFileStore(), follow=Follow(self._follow, self._follow_block)
        )

    @property
    def facts(self) -> list[StoredFact]:
        """All facts, in their order."""
        return self._store.written

    def observed(self) -> list[tuple[str, str]]:
        """Return (sha256, path) of every rollout behind an observation, in the order of the manifest."""
        tests = set[tuple[str, int]]()
        for fact in self.facts:
            if isinstance(fact, ObservationFact):
                tests.add((fact.problem, fact.test))
            elif isinstance(fact, BlockObservationFact):
                tests.update((fact.problem, test) for test in range(fact.test, fact.test + len(fact)))
        order = list(self.ledger.series)
        found = [f for f in self.facts if isinstance(f, RolloutFact | BatchFact) and f.rollout[:2] in tests]
        found.sort(key=lambda fact: (order.index(fact.rollout.problem), *fact.rollout[1:], -places(fact)))
        return [(fact.sha256, fact.path) for fact in found]

    def play(self, progress: Callable[[int], None]) -> None:
        """Decide the whole campaign; `progress` is called with the number of files admitted.

        Raises:
            CheckFailed: the evidence is not that of this campaign.

        """
        self._check_size()
        used, missing = set[FileId](), list[RolloutId]()
        waiting = deque(self._step(self.ledger.outstanding))
        while waiting or self._extensions:
            if not waiting:
                waiting.extend(self._extend(missing))
                continue
            rollout = waiting.popleft()
            file = file_of(self.ledger.request(rollout))
            if file not in self._entries:
                missing.append(rollout)  # legal if its problem stops before it is needed
                continue
            # Evidence is what was observed: a file from after the stop could have been chosen by its outcome.
            if rollout.problem in self._stopped():
                raise CheckFailed("stop", f"{rollout} is in the manifest, but its problem had stopped before it")
            waiting.extend(self._take(rollout, self._entries[file]))
            used.add(file)
            progress(len(used))
        self._check_end(used, missing)

    def _check_size(self) -> None:
        """Refuse a campaign whose first tests alone need more rollouts than the manifest has."""
        # The header is untrusted: 10^9 replicates in it would fill the memory before a file is missing.
        for each in self.ledger.state.problems:
            mine = (file for file in self._entries if file.rollout.problem == each.plan.problem)
            listed = sum(file.places or 1 for file in mine)
            if listed < len(each.plan.rollouts):
                wanted = f"{len(each.plan.rollouts):,} rollouts a test"
                raise CheckFailed("evidence", f"{each.plan.problem} needs {wanted}, the manifest lists {listed:,}")

    def _extend(self, missing: Sequence[RolloutId]) -> Sequence[RolloutId]:
        """Extend the campaign, which has to be done, as the certificate lists it."""
        if not self.ledger.done:
            self._check_end(set(), missing)
        fact = self._extensions.popleft()
        try:
            return self._step(lambda: self.ledger.extend(fact))
        except IllegalEvent as error:
            raise CheckFailed("stop", str(error)) from None

    def _stopped(self) -> set[str]:
        return {each.plan.problem for each in self.ledger.state.problems if each.stopped_by is not None}

    def _step(self, act: Callable[[], Work]) -> Sequence[RolloutId]:
        try:
            return act().wanted
        except PerfboundError as error:
            raise CheckFailed("observations", str(error)) from None

    def _discard(self, rollout: RolloutId) -> None:
        """Discard what was discarded of the test of a rollout, before its test is observed."""
        mine = [fact for fact in self._discards if fact.rollout[:2] == rollout[:2]]
        self._discards = [fact for fact in self._discards if fact not in mine]
        series = self.ledger.series[rollout.problem]
        # In their order: each is compared with what is kept of its test, as when it was discarded.
        series.discards += [self._checked(fact, mine) for fact in mine]
        for fact in series.discards[len(series.discards) - len(mine) :]:
            self._store.add(fact)

    def _checked(self, fact: DiscardFact, mine: Sequence[DiscardFact]) -> DiscardFact:
        def others(key: tuple[str, int]) -> list[Trajectory]:
            partner = RolloutId(*fact.rollout[:2], *key)
            found = [Entry(each.sha256, each.path) for each in mine if each.rollout == partner]
            found += [self._entries[FileId(partner)]] if FileId(partner) in self._entries else []
            return [decode(self._read(entry)) for entry in found]

        payload = self._read(Entry(fact.sha256, fact.path))
        return check_discard(self.ledger, fact, self._columns, payload, others)

    def _take(self, rollout: RolloutId, entry: Entry) -> Sequence[RolloutId]:
        if self._discards:
            self._discard(rollout)
        payload = self._read(entry)
        # As the service admits a result: the request follows from the decisions so far, not from the file.
        try:
            request = self.ledger.request(rollout)
            found: Trajectory | Scored
            if isinstance(request, BatchRequest):
                batch = admit_stored(request, self._columns, payload, entry.sha256)
                found = scored(self.ledger, request, batch)
            else:
                found = admit(request, self._columns, payload, entry.sha256)
        except RequestError as error:
            raise CheckFailed("requests", f"{entry.path}: {error}") from None
        except EvidenceError as error:
            raise CheckFailed("trajectories", f"{entry.path}: {error}") from None
        return self._step(lambda: self.ledger.record(rollout, payload, found, entry.sha256))

    def _read(self, entry: Entry) -> bytes:
        try:
            return files.read_evidence(self._directory, entry.path, entry.sha256)
        except EvidenceError as error:
            raise CheckFailed("files", str(error)) from None

    def _follow(
        self, problem: str, test: int, recomputed: Proposal, rival: Callable[[Sequence[float]], Proposal | None]
    ) -> Proposal:
        """Return the recorded test if it is a maximiser up to round-off: another CPU may break a tie otherwise."""
        x = self._start(problem, test)
        if x is None or x == recomputed.x:
            return recomputed
        recorded = rival(x)
        if recorded is None:
            found = f"{list(x)} was tested, the maximiser is {list(recomputed.x)}"
            raise CheckFailed("proposals", f"{problem}, test {test}: {found}")
        self.ties += 1
        return recorded

    def _start(self, problem: str, test: int) -> tuple[float, ...] | None:
        """Return the start of a test, from the request in its first file."""
        file = self._first.get((problem, test))
        if file is None:
            return None
        entry = self._entries[file]
        try:
            if file.places:
                return self._starts(file)[0]
            request = read_mcap(self._read(entry)).request
            found = request.get("start") or request["x"]
            return tuple(float(value) for value in found)
        except (TrajectoryError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise CheckFailed("trajectories", f"{entry.path}: {error}") from None

    def _follow_block(
        self, own: BlockProposalFact, rival: Callable[[int, Sequence[float]], Proposal | None]
    ) -> BlockProposalFact:
        """Return the recorded starts of a block, if they are its own up to round-off; see `_follow`."""
        file = self._first.get((own.problem, own.test))
        if file is None:
            return own
        try:
            x = np.array(self._starts(file))
        except (TrajectoryError, ValueError) as error:
            raise CheckFailed("trajectories", f"{self._entries[file].path}: {error}") from None
        if x.shape != own.x.shape:
            found = f"{x.shape} starts are in its file, {own.x.shape} follow from the campaign"
            raise CheckFailed("proposals", f"{own.problem}, tests from {own.test}: {found}")
        for place in np.flatnonzero((x != own.x).any(axis=1)).tolist():
            if rival(place, x[place].tolist()) is None:
                found = f"{x[place].tolist()} was tested, {own.x[place].tolist()} follows from the campaign"
                raise CheckFailed("proposals", f"{own.problem}, test {own.test + place}: {found}")
            self.ties += 1
        return BlockProposalFact.of(own.problem, own.test, own.nodes, x)

    def _starts(self, file: FileId) -> tuple[tuple[float, ...], ...]:
        return BatchRequest.model_validate_json(read_stored(self._read(self._entries[file])).request).chosen

    def _check_end(self, used: set[FileId], missing: Sequence[RolloutId]) -> None:
        # A campaign cut at a good moment: its rule has not stopped it.
        if not self.ledger.done:
            gone = next(rollout for rollout in missing if rollout.problem not in self._stopped())
            raise CheckFailed("stop", f"the campaign does not end there: {gone} is due next, and the manifest lacks it")
        extra: list[object] = [file for file in self._entries if file not in used]
        extra += [each.rollout for each in self._discards]
        if extra:
            raise CheckFailed("evidence", f"{counted(len(extra), 'file')} of no observed test: {extra[0]}")

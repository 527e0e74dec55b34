"""Ask and tell: a campaign whose rollouts are made elsewhere, on a rig, in a vehicle or in another program's loop.

No worker and no network: the ledger itself. What is handed in is admitted by the checks of a worker's result, and is
durable before the next request follows from it.
"""

import os
import threading
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from ..orchestrator.campaign.admission import Admission
from ..orchestrator.campaign.ledger import Ledger, Work
from ..orchestrator.campaign.software import software
from ..orchestrator.certificate import files
from ..orchestrator.run import session
from ..orchestrator.run.certify import certify
from ..orchestrator.run.directory import stored_differently
from ..orchestrator.run.link import Link
from ..orchestrator.run.options import RunOptions, check_own, reopened
from ..orchestrator.store import read
from ..orchestrator.store.journal import Journal
from ..orchestrator.store.rows import DATABASE
from ..schemas.amounts import counted
from ..schemas.batch import alone
from ..schemas.errors import PerfboundError, RequestError, UnusableTrajectoryError, shortened
from ..schemas.failure import Failure
from ..schemas.file.config import CampaignConfig
from ..schemas.host import host_name
from ..schemas.ids import Attempt, RolloutId
from ..schemas.link.configuration import LOCAL
from ..schemas.result.facts import RECORDED, RESTORED, Header
from ..schemas.rollout import RolloutRequest
from ..schemas.system import OptionValue, SystemSpec
from ..schemas.trajectory.batch import digest_of
from ..schemas.trajectory.input_signal import start_values
from .handed_in import Admitted, admitted
from .process import reproducible
from .run import Run
from .system_argument import GivenSystem

SILENT = Console(quiet=True)
_BY_HAND = RunOptions(0, Link(LOCAL))
"""Of sessions without workers."""
TOLD_BY = "told"
"""The worker of a rollout that was handed in."""


@dataclass(frozen=True)
class TrialRequest:
    """A rollout that is wanted: make one from `start`, and hand in its trajectory from 0 to `horizon` s."""

    id: str
    start: Mapping[str, Any]
    """The starting condition by parameter, in the units of the system: a number, or the `InputSignal` of one."""
    variant: str
    seed: int
    horizon: float
    options: Mapping[str, OptionValue]
    disturbances: Mapping[str, float]
    """The value of each disturbance that the system declares, by its name."""
    request: RolloutRequest
    """All of it, as a worker gets it."""

    @classmethod
    def of(cls, request: RolloutRequest, spec: SystemSpec) -> "TrialRequest":
        """Return a request with the names of the parameters."""
        return cls(
            id=request.rollout,
            start=start_values(spec, request.x, request.horizon),
            variant=request.variant,
            seed=request.seed,
            horizon=request.horizon,
            options=request.options,
            disturbances=dict(zip((each.name for each in spec.disturbances), request.disturbances, strict=True)),
            request=request,
        )

    @property
    def x(self) -> tuple[float, ...]:
        """The starting condition (p,), in the order of the parameters."""
        return self.request.x


class _Rollouts:
    """The rollouts of a campaign that are told: those that are wanted, and those that are recorded."""

    def __init__(self, directory: Path, journal: Journal) -> None:
        self.directory, self._journal, self._ledger = directory, journal, Ledger(directory, journal)
        self._admission = Admission(self._ledger)
        self.spec = journal.header.spec
        self.wanted: dict[RolloutId, None] = {}
        """In the order of the tests."""
        self._attempts = read.attempts(directory)
        self._ledger.replay()
        self._ledger.check_files(journal)
        with self._ledger.transaction():
            self._take(self._ledger.outstanding())
        self._certify()

    def known(self, name: object) -> RolloutId:
        """Return the rollout of a request that is wanted, or was told before; raises `RequestError`."""
        if not isinstance(name, str):
            raise _no_request(name)
        try:
            rollout = RolloutId.parse(name)
        except ValueError:
            raise _no_request(name) from None
        if rollout not in self.wanted and all(rollout != fact.rollout for fact in self._journal.recorded()):
            raise RequestError(f"{rollout}: not wanted, or no longer; ask again")
        return rollout

    def request(self, rollout: RolloutId) -> RolloutRequest:
        """Return the request of a rollout that is wanted or was told."""
        if rollout in self.wanted:
            return alone(self._ledger.request(rollout))
        start = self._journal.proposal(rollout.problem, rollout.test).proposal.x
        return self._ledger.header.template.request(rollout, start, self._journal.rollout(rollout).seed)

    def same(self, rollout: RolloutId, told: Admitted) -> bool:
        """Whether a rollout was told the same trajectory before, in whatever form."""
        fact = self._journal.rollout(rollout)
        return fact.sha256 == told.sha256 or self._ledger.recorded.digest(rollout) == digest_of(told.trajectory)

    def check(self, rollout: RolloutId, told: Admitted) -> None:
        """Refuse a trajectory from which the objective cannot be computed."""
        try:
            self._admission.check(rollout, told.trajectory)
        except UnusableTrajectoryError as fault:
            raise UnusableTrajectoryError(f"{rollout}: {fault}") from None

    def record(self, rollout: RolloutId, told: Admitted) -> None:
        """Make a trajectory durable, and everything that follows from it."""
        outcome = RESTORED if self._ledger.restores(rollout) else RECORDED
        with self._ledger.transaction():
            attempt = self._attempt(rollout)
            work = self._ledger.record(rollout, told.payload, told.trajectory, told.sha256)
            self._journal.attempts.ended(attempt, TOLD_BY, outcome)
        del self.wanted[rollout]
        self._take(work)
        self._certify()

    def failed(self, rollout: RolloutId, reason: str) -> None:
        """Record a trial that the system did not survive."""
        with self._ledger.transaction():
            self._journal.attempts.ended(self._attempt(rollout), TOLD_BY, Failure("system", reason))

    def _attempt(self, rollout: RolloutId) -> Attempt:
        attempt = Attempt(rollout, self._attempts.get(rollout, 0) + 1)
        self._attempts[rollout] = attempt.number
        self._journal.attempts.started(attempt, TOLD_BY, host_name(), os.getpid())
        return attempt

    def _take(self, work: Work) -> None:
        self.wanted |= dict.fromkeys(work.wanted)
        for rollout in work.unwanted:
            self.wanted.pop(rollout, None)

    def _certify(self) -> None:
        if not self._ledger.done or files.read(self.directory) is not None:
            return
        self._journal.check_place()
        if self._ledger.check_files(self._journal, whole=True):
            self._take(self._ledger.outstanding())  # what was removed meanwhile is wanted again
        else:
            certify(self.directory, self._ledger)


class Study:
    """A campaign that is asked and told, under the lock of its run directory, by any threads of one process.

    Every `tell` is durable when it returns: the process may end at any time, and the same call continues. `close`
    releases the directory, and so does the end of a `with` block. Threads that make rollouts at the same time take them
    from `requests`, because `ask` returns the same one to all.
    """

    def __init__(self, directory: Path, journal: Journal, stack: ExitStack, step: float | None) -> None:
        self.directory, self._stack, self._step = directory, stack, step
        self._process, self._lock = os.getpid(), threading.RLock()
        with reproducible():
            self._open: _Rollouts | None = _Rollouts(directory, journal)

    @property
    def run(self) -> Run:
        """The run so far: its tables, and at the end its certificate."""
        return Run(self.directory)

    @property
    def requests(self) -> tuple[TrialRequest, ...]:
        """Every rollout that is wanted now, in the order of the tests: these may be made at the same time."""
        with self._locked() as rollouts:
            return tuple(TrialRequest.of(rollouts.request(each), rollouts.spec) for each in rollouts.wanted)

    def ask(self) -> TrialRequest | None:
        """Return the next rollout that is wanted, the same one until it is told; None when the campaign is done."""
        with self._locked() as rollouts:
            # Nobody remembers who was asked: a restart changes nothing, and no lease ends while a rig takes a day.
            first = next(iter(rollouts.wanted), None)
            return None if first is None else TrialRequest.of(rollouts.request(first), rollouts.spec)

    def tell(self, request: TrialRequest | str, data: object, *, step: float | None = None) -> None:
        """Hand in the trajectory of a request, or of its id.

        `data` is what a function under `@perfbound.system` may return: a `Trajectory`, an array (T,) for each column,
        one array (T, n), a dict or a DataFrame of columns; or a path: a CSV file with a line of titles, or the MCAP
        file that `perfbound` has made for this request. Without a column `t`, `step` is the time between two samples.
        The same data told again change nothing.

        Data that do not fit, are not finite, or end before the horizon, are refused, and change nothing: they may be a
        slip. A trial that failed is recorded by `failed`.

        Raises:
            PerfboundError: one line with the request and the reason; the request stays open. Or other data were told
                before.

        """
        with self._locked() as rollouts:
            rollout = _known(rollouts, request)
            told = admitted(rollouts.request(rollout), rollouts.spec, data, self._step if step is None else step)
            if rollout not in rollouts.wanted:
                if not rollouts.same(rollout, told):
                    raise RequestError(f"{rollout}: another trajectory was told before, and a record never changes")
                return
            rollouts.check(rollout, told)
            with self._closed_by_a_fault():
                rollouts.record(rollout, told)

    def failed(self, request: TrialRequest | str, reason: str) -> None:
        """Record that the trial of a request failed in the system, as a rollout that ends with an exception.

        The request stays open. If a later trial of it succeeds, the certificate lists `reproducible_rollouts` as
        refuted: a trial that is repeated until it succeeds is selected by its outcome.

        Raises:
            PerfboundError: the request has its trajectory already, or is none; or the reason is no text.

        """
        with self._locked() as rollouts:
            rollout = _known(rollouts, request)
            if rollout not in rollouts.wanted:
                raise RequestError(f"{rollout}: it has its trajectory already, and a record never changes")
            text = _reason(rollout, reason)
            with self._closed_by_a_fault():
                rollouts.failed(rollout, text)

    def close(self) -> None:
        """Release the run directory; everything that was told is durable.

        Raises:
            PerfboundError: another process has opened it.

        """
        self._check_process()
        with self._lock:
            self._open = None
            self._stack.close()

    @contextmanager
    def _locked(self) -> Iterator[_Rollouts]:
        """Give one thread after the other the state of the campaign."""
        self._check_process()  # before the lock: in a fork it may be held by a thread that is not there
        with self._lock, reproducible():
            if self._open is None:
                raise PerfboundError(f"{self.directory}: this study is closed; open it again with ask_tell")
            yield self._open

    @contextmanager
    def _closed_by_a_fault(self) -> Iterator[None]:
        """Close the study if an exception breaks off what is written."""
        try:
            yield
        except BaseException:
            self.close()  # the ledger may be ahead of its journal, which alone counts: only a replay continues
            raise

    @property
    def is_here(self) -> bool:
        """Whether this process opened the study; a fork of it has a copy that must stay untouched."""
        return os.getpid() == self._process

    def _check_process(self) -> None:
        # Two processes with one connection of SQLite, or one ledger each, write facts that contradict each other.
        if not self.is_here:
            raise PerfboundError(
                f"{self.directory}: this study is one of process {self._process}, this is process {os.getpid()}; "
                "return the data to that process, and tell them there"
            )

    def __reduce__(self) -> NoReturn:
        raise PerfboundError(
            f"{self.directory}: this study stays in process {self._process}; give other processes its requests, "
            "return their data, and tell it here"
        )

    def __enter__(self) -> "Study":
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_here:  # a fork that leaves the block releases nothing of its parent's
            self.close()

    def __repr__(self) -> str:
        """Return the directory, and the number of wanted rollouts."""
        now = self._open
        state = "closed" if now is None else f"{counted(len(now.wanted), 'rollout')} wanted"
        return f"<Study in {self.directory}: {state}>"


def _known(rollouts: _Rollouts, request: object) -> RolloutId:
    """Return the rollout of a request of this study, or of its id."""
    if not isinstance(request, TrialRequest):
        return rollouts.known(request)
    rollout = rollouts.known(request.id)
    if request.request != rollouts.request(rollout):
        raise RequestError(f"{rollout}: this request is one of another campaign; ask again")
    return rollout


def _reason(rollout: RolloutId, given: object) -> str:
    if not isinstance(given, str) or not given.strip():
        raise RequestError(f"{rollout}: reason: {shortened(repr(given), 80)} is no text; give why the trial failed")
    return given


def _no_request(given: object) -> RequestError:
    return RequestError(f"{shortened(repr(given), 80)} is no request; give what ask() returned, or its id")


_OPEN: "weakref.WeakValueDictionary[Path, Study]" = weakref.WeakValueDictionary()
"""The studies of this process, by directory."""


def open_study(directory: Path, config: CampaignConfig | None = None, system: GivenSystem | None = None) -> Study:
    """Continue the study in `directory`, or begin that of a campaign there.

    Raises:
        PerfboundError: there is no campaign, another one, or it is in use.

    """
    directory = directory.absolute()  # a later chdir must not lead to another campaign
    # A cell of a notebook that is run again: the study that it made before holds the lock.
    if (before := _OPEN.get(directory)) is not None and before.is_here:
        before.close()
    step = system.step if system else None
    with ExitStack() as stack:
        if (directory / DATABASE).exists() or config is None or system is None:
            if config is not None and (found := stored_differently(directory, config)):
                raise PerfboundError(f"{directory}: another campaign is here ({found}); choose another `out`")
            # No worker: of an installed system nothing is compared: the caller has it.
            options = replace(_BY_HAND, system=system.reference if system else None)
            journal, _ = stack.enter_context(reopened(directory, options))
            _check_opinions(journal.header.config)
            if system is not None and system.spec.repeated != "anywhere":
                check_own(journal.header, system.spec)
        else:
            _check_opinions(config)
            header = Header.new(config, system.spec, software(system.spec))
            journal = stack.enter_context(session.created(directory, header, _BY_HAND.origin(system.reference)))
        study = Study(directory, journal, stack.pop_all(), step)
    _OPEN[directory] = study
    return study


def _check_opinions(config: CampaignConfig) -> None:
    """Refuse a campaign whose certificate would state comparisons that nobody makes."""
    if config.second_opinion:
        raise PerfboundError(
            "second_opinion: rollouts that are handed in have no second worker; leave the key out, or run the campaign"
        )

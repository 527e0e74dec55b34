"""Ask and tell: a campaign whose rollouts are made elsewhere, on a rig, in a vehicle or in another program's loop.

No worker and no network: the ledger itself. What is handed in is admitted by the checks of a worker's result, and is
durable before the next request follows from it.
"""

import os
import threading
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from ..orchestrator.run.told import ToldRollouts, journal_in
from ..orchestrator.store.journal import Journal
from ..schemas.amounts import counted
from ..schemas.errors import PerfboundError, RequestError, shortened
from ..schemas.file.config import CampaignConfig
from ..schemas.ids import RolloutId
from ..schemas.rollout import RolloutRequest
from ..schemas.system import OptionValue, SystemSpec
from ..schemas.trajectory.input_signal import start_values
from .handed_in import admitted
from .process import reproducible
from .run import Run
from .system_argument import GivenSystem


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


class Study:
    """A campaign that is asked and told, under the lock of its run directory, by any threads of one process.

    Every `tell` is durable when it returns: the process may end at any time, and the same call continues. `close`
    releases the directory, and so does the end of a `with` block. Threads that make rollouts at the same time take them
    from `requests`, because `ask` returns the same one to all.
    """

    def __init__(self, directory: Path, journal: Journal, stack: ExitStack, step: float | None) -> None:
        self.directory, self._stack = directory, stack
        self._step = step or journal.header.config.system.step
        self._process, self._lock = os.getpid(), threading.RLock()
        with reproducible():
            self._open: ToldRollouts | None = ToldRollouts(directory, journal)

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

    def tell(
        self,
        request: TrialRequest | str,
        data: object,
        *,
        start: Mapping[str, float] | None = None,
        disturbances: Mapping[str, float] | None = None,
        step: float | None = None,
    ) -> None:
        """Hand in the trajectory of a request, or of its id.

        `start` is the start that was driven, by parameter, where the rig has a tolerance: it is the record, in the
        columns `driven_NAME`. `disturbances` are the values of those that the rig reports, where `data` lack them.

        `data` is what a function under `@perfbound.system` may return: a `Trajectory`, an array (T,) for each column,
        one array (T, n), a dict or a DataFrame of columns; or the path of a log: of CSV, Parquet, MAT, MCAP or a bag,
        as the campaign file maps it, or the MCAP file that `perfbound` has made for this request. Without a column
        `t`, `step` is the time between two samples.
        The same data told again change nothing.

        Data that do not fit, are not finite, or end before the horizon, are refused, and change nothing: they may be a
        slip. A trial that failed is recorded by `failed`.

        Raises:
            PerfboundError: one line with the request and the reason; the request stays open. Or other data were told
                before.

        """
        with self._locked() as rollouts:
            rollout = _known(rollouts, request)
            asked, apart = rollouts.request(rollout), self._step if step is None else step
            told = admitted(asked, rollouts.spec, data, apart, rollouts.mapping, start=start, disturbances=disturbances)
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
    def _locked(self) -> Iterator[ToldRollouts]:
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


def _known(rollouts: ToldRollouts, request: object) -> RolloutId:
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
    given = (None, None) if system is None else (system.spec, system.reference)
    with ExitStack() as stack:
        journal = stack.enter_context(journal_in(directory, config, *given))
        study = Study(directory, journal, stack.pop_all(), step)
    _OPEN[directory] = study
    return study

"""The state of the dispatch machine: workers, open rollouts, and the standing of workers and hosts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from ....schemas.ids import Attempt, WorkId, first_of
from .limits import Limits
from .retries import Open
from .standing import Place, Standing

WorkerPhase = Literal["new", "idle", "sent", "busy", "shunned", "gone"]
NEVER = float("inf")
SERVING: tuple[WorkerPhase, ...] = ("idle", "sent", "busy")
"""Phases of a worker that takes a rollout now or soon: out of `new` and `shunned` a hanging one may never come."""


@dataclass(frozen=True, slots=True)
class Worker:
    """One worker process in the view of the orchestrator."""

    phase: WorkerPhase = "new"
    attempt: Attempt | None = None
    host: str = ""
    leaving: bool = False
    """Whether it has said that it ends, and gets nothing more."""
    resumes_as: WorkerPhase = "idle"
    """Its phase if its token comes back; of a `gone` worker alone."""
    replaced: bool = False
    """Whether another process takes its place, so that its token does not come back; of a `gone` worker alone."""
    gone_at: float = NEVER
    sent_at: float = NEVER
    """Of the last assign message."""
    started_at: float = NEVER
    """Of its attempt; of a `new` or `shunned` worker, when it became so."""
    progress: int = -1
    progress_at: float = NEVER

    def shunned(self, at: float) -> "Worker":
        """Return the worker without its assignment, with which it may still be busy."""
        if self.phase == "gone":  # the token decides first whether the process is lost
            return replace(self, attempt=None, resumes_as="shunned")
        return Worker("shunned", host=self.host, started_at=at, progress_at=at)


@dataclass(frozen=True, slots=True)
class DispatchState:
    """Workers, open rollouts in order of arrival, and those of them that wait for a worker."""

    limits: Limits
    hold_until: float = 0.0
    """Nothing is assigned before this time: after a restart busy workers report first."""
    linked: bool = True
    """Whether the link to the router is up; without a router always."""
    linked_at: float = -NEVER
    """When it came back last."""
    grace: float = 0.0
    """Seconds for gone workers to return, since a router or the link to it has changed; nothing without a router."""
    patient_until: float = 0.0
    """The end of that time, which was counted from the last change."""
    alone_from: float = 0.0
    """Before this time workers that are not known yet may come and decide a dispute: those of before a restart."""
    workers: Mapping[str, Worker] = field(default_factory=dict)
    open: Mapping[WorkId, Open] = field(default_factory=dict)
    waiting: tuple[WorkId, ...] = ()
    standings: Mapping[Place, Standing] = field(default_factory=dict)
    """Of the workers and hosts that failed and have not succeeded since."""
    proven: frozenset[str] = frozenset()
    """Hosts that have recorded rollouts."""
    second_opinion: bool = False
    """Whether the first results of a worker are compared."""
    comparisons: Mapping[str, int] = field(default_factory=dict)
    """Results of a worker that agreed with another one's."""
    variants: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """Of the workers that simulate only some variants of the system."""

    def is_undecided(self, rollout: WorkId) -> bool:
        """Whether nothing has been decided on an open rollout since its last attempt ended."""
        held = any(each.attempt is not None and each.attempt.rollout == rollout for each in self.workers.values())
        return not (self.open[rollout].poisoned or held or rollout in self.waiting)

    def simulates(self, worker: str, rollout: WorkId) -> bool:
        """Whether a worker has the simulator of a rollout."""
        return worker not in self.variants or first_of(rollout).variant in self.variants[worker]

    def host(self, worker: str) -> str:
        """Return the host of a worker; of one that has been removed, none."""
        return self.workers.get(worker, Worker()).host

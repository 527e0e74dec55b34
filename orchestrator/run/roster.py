"""The worker processes of a run: their tokens and heartbeats, and the admission of those that may serve the campaign.

The protocol: a worker shows its liveliness token, then sends heartbeats, which name its version and its systems. A
worker that fits the campaign is `up` for the dispatch machine from its first heartbeat on; any other one is refused
once and then ignored.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ...schemas import __version__
from ...schemas.ids import Attempt, parse_work
from ...schemas.link.messages import HEARTBEAT, PROTOCOL, WorkerState, heartbeat_interval, is_near
from ...schemas.platforms import ANY
from ...schemas.system import SystemSpec
from ..fleet.dispatch import events
from ..fleet.link.transport import Heartbeat, Token


@dataclass(slots=True)
class WorkerRecord:
    """A worker process as the protocol shows it."""

    alive: bool = False
    state: WorkerState | None = None
    """The last heartbeat; None before the worker is admitted."""
    refused: bool = False
    last_heartbeat: float = 0.0
    """Time of the last heartbeat, by the monotonic clock."""
    interval: float = HEARTBEAT
    """Seconds between its heartbeats, as the orchestrator has set it."""


LIVING = 10_000
"""Workers at a time; tokens above that are ignored, which is reported."""
MOST_NAMED = 3
"""Files or versions in a refusal."""
DEAD_KEPT = 500
"""Workers whose token is gone: one that returns after a partition is known, older ones are admitted anew."""


class Roster:
    """The workers of one run, by name: those that live, and the last ones that do not."""

    def __init__(self, spec: SystemSpec, platform: str) -> None:
        self.records: dict[str, WorkerRecord] = {}
        self._living = 0
        self._dead: dict[str, None] = {}
        """In the order in which their tokens disappeared."""
        self._spec, self._spec_sha256, self._platform = spec, spec.digest, platform

    def token(self, message: Token, *, local: bool = False) -> tuple[events.Event, ...]:
        """Take the token of a worker that came or went; return the events for the dispatch machine.

        A `local` worker is a process of this run, which replaces it.
        """
        if message.worker not in self.records and (not message.alive or self.is_full):
            return ()
        record = self.records.setdefault(message.worker, WorkerRecord())
        self._living += message.alive - record.alive
        record.alive, record.interval = message.alive, HEARTBEAT  # as a worker does that has lost its orchestrator
        self._remember(message.worker, alive=message.alive)
        if record.state is not None:
            # The record outlives the token: after a partition the same process returns, perhaps with its result.
            if not message.alive:
                return (events.WorkerDown(message.at, message.worker, replaced=local),)
            return (self._up(message.at, message.worker, record.state),)
        if not message.alive:
            del self.records[message.worker]  # never admitted, so no attempt can come back from it
            del self._dead[message.worker]
        return ()

    @property
    def is_full(self) -> bool:
        """Whether no further worker gets work."""
        return self._living >= LIVING

    def is_one_too_many(self, message: Token) -> bool:
        """Whether a worker that appears gets no work, because so many others live."""
        return message.alive and self.is_full and message.worker not in self.records

    def _remember(self, worker: str, *, alive: bool) -> None:
        self._dead.pop(worker, None)
        if not alive:
            self._dead[worker] = None
            while len(self._dead) > DEAD_KEPT:
                oldest = next(iter(self._dead))
                del self._dead[oldest], self.records[oldest]

    def refusal(self, message: Heartbeat) -> str | None:
        """Return the reason to refuse a worker, at its first heartbeat alone."""
        record = self.records.get(message.worker)
        if record is None or not record.alive or record.refused or record.state is not None:
            return None
        reason = self._mismatch(message.state)
        record.refused = reason is not None
        return reason

    def heartbeat(self, message: Heartbeat) -> tuple[events.Event, ...]:
        """Take a heartbeat that is no reason for a refusal; return the events for the dispatch machine."""
        record = self.records.get(message.worker)
        # The token comes first, also after a partition: without it a heartbeat is a late one of a lost worker.
        if record is None or not record.alive or record.refused:
            return ()
        up = () if record.state else (self._up(message.at, message.worker, message.state),)
        record.last_heartbeat, record.state = message.at, message.state
        state, attempt = message.state, None
        if state.rollout is not None and state.attempt is not None:
            attempt = Attempt(parse_work(state.rollout), state.attempt)
        return (*up, events.Reported(message.at, message.worker, attempt, state.progress, bool(state.leaving)))

    def admitted(self, worker: str) -> WorkerState | None:
        """Return the last heartbeat of an admitted worker; None for every other one."""
        record = self.records.get(worker)
        return record.state if record is not None else None

    def new_intervals(self, hung_after: float) -> dict[str, float]:
        """Return the admitted workers whose heartbeats are to have another interval from now on, in s, with it."""
        wanted = heartbeat_interval(self._living, hung_after)
        found = [name for name in self.living if not is_near(self.records[name].interval, wanted)]
        for name in found:
            self.records[name].interval = wanted
        return dict.fromkeys(found, wanted)

    @property
    def living(self) -> list[str]:
        """Admitted workers whose token is there."""
        return [name for name, each in self.records.items() if each.alive and each.state is not None]

    def _up(self, at: float, worker: str, state: WorkerState) -> events.WorkerUp:
        has = self._simulators(state)
        only = has if self._spec.simulators and len(has) < len(self._spec.simulators) else None
        return events.WorkerUp(at, worker, state.host, only)

    def _simulators(self, state: WorkerState) -> frozenset[str]:
        """Return the variants of a system of two simulators that a worker simulates."""
        found = self._spec.simulators.items()
        return frozenset(name for name, sha256 in found if state.systems.get(f"{self._spec.name}/{name}") == sha256)

    def _mismatch(self, state: WorkerState) -> str | None:
        spec = self._spec
        if state.protocol != PROTOCOL or state.version != __version__:
            theirs, ours = f"{state.version} (protocol {state.protocol})", f"{__version__} (protocol {PROTOCOL})"
            return f"the worker is perfbound {theirs}, the orchestrator {ours}; install the same version on both"
        if self._simulators(state):
            return self._other_platform(state)
        if spec.name not in state.systems:
            remedy = (
                "run `perfbound systems` there, and install what is missing, or start it with --system FILE.py:NAME"
            )
            return f"the worker has no system {spec.name!r}; {remedy}"
        if self._spec_sha256 != state.systems[spec.name]:
            # Another build may give other trajectories for the same seed; one certificate names one build.
            what = _what_differs(spec, state.parts.get(spec.name))
            return f"the worker's {spec.name!r} has {what} than the campaign's; use the same on both"
        return self._other_platform(state)

    def _other_platform(self, state: WorkerState) -> str | None:
        if self._platform not in (ANY, state.platform):
            return (
                f"the worker's platform is {state.platform or 'unknown'}, the campaign's {self._platform}, and their "
                "rollouts may differ in the last bits; choose workers of one platform, or name it in the campaign file "
                "(platform)"
            )
        return None


def _what_differs(spec: SystemSpec, parts: Collection[str] | None) -> str:
    """Return in what a worker's system of the same name is another one; `parts` are its files and packages."""
    if parts is None:  # too many for a heartbeat
        return "other files or versions of packages"
    missing = [name for part, name in spec.parts.items() if part not in parts]
    if missing:
        return f"another or no {_first_names(missing)}"
    more = len(set(parts) - spec.parts.keys())
    return f"{more} files or packages more" if more else "other parameters, columns or options"


def _first_names(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")

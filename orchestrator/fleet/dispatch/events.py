"""Events and actions of the dispatch machine; `at` is in seconds of any one clock."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ....schemas.failure import Failure
from ....schemas.ids import Attempt, RolloutId, WorkId
from .standing import Place


@dataclass(frozen=True, slots=True)
class Opinion:
    """A result that is compared."""

    worker: str
    host: str
    attempt: Attempt
    digest: str
    doubtful: bool = False
    """Whether it is compared for a doubt alone, and not for the honesty of its worker."""
    each: tuple[bytes, ...] = ()
    """Of a batch the digest of each rollout, empty for one that failed."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """Rollouts to be simulated, each with its attempts before a restart."""

    at: float
    rollouts: tuple[tuple[WorkId, int], ...]
    avoid: Mapping[WorkId, str] = field(default_factory=dict)
    """Workers that shall not simulate a rollout while there is another one: a recheck by another process says more."""
    compared: frozenset[WorkId] = frozenset()
    """Those that get a second opinion."""
    failed: Mapping[WorkId, tuple["EarlierFailure", ...]] = field(default_factory=dict)
    """Failures before a restart that count."""
    opinions: Mapping[WorkId, tuple[Opinion, ...]] = field(default_factory=dict)
    """Results that were compared before a restart."""
    handed_back: Mapping[WorkId, int] = field(default_factory=dict)
    """Times that workers handed a rollout back before a restart."""


@dataclass(frozen=True, slots=True)
class Unwanted:
    """Rollouts that are no longer needed; of a batch its first one."""

    at: float
    rollouts: tuple[RolloutId, ...]


@dataclass(frozen=True, slots=True)
class WorkerUp:
    """A worker that may serve this campaign is alive."""

    at: float
    worker: str
    host: str = ""
    variants: frozenset[str] | None = None
    """Those that it simulates, of a system of two simulators; None for all."""


@dataclass(frozen=True, slots=True)
class WorkerDown:
    """The liveliness token of a worker is gone."""

    at: float
    worker: str
    replaced: bool = False
    """Whether another process takes its place: a local one does not come back."""


@dataclass(frozen=True, slots=True)
class Reported:
    """A heartbeat: `attempt` is the one that the worker is busy with."""

    at: float
    worker: str
    attempt: Attempt | None
    progress: int
    leaving: bool = False
    """Whether the worker takes no more rollouts."""


@dataclass(frozen=True, slots=True)
class Delivered:
    """The end of an attempt: a valid result, or the failure."""

    at: float
    worker: str
    attempt: Attempt
    failure: Failure | None
    digest: str = ""
    """Of a result."""
    doubtful: bool = False
    """Whether something in the result is unlike all others, so that it counts only if it is repeated."""
    each: tuple[bytes, ...] = ()
    """As in `Opinion`."""


@dataclass(frozen=True, slots=True)
class HandedBack:
    """A worker that ends has stopped an attempt."""

    at: float
    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Tick:
    """Time has passed, and everything received before has been handled."""

    at: float


@dataclass(frozen=True, slots=True)
class RouterChanged:
    """A router appeared or disappeared, and at the same time the tokens of the workers behind it."""

    at: float
    grace: float
    """Seconds for those workers to return."""


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The orchestrator's own link to its router is down, or there again."""

    at: float
    grace: float
    """Seconds for the workers to return once it is there again."""
    up: bool


@dataclass(frozen=True, slots=True)
class HandOut:
    """The end of a turn: waiting rollouts go to idle workers."""

    at: float


Event = (
    Wanted
    | Unwanted
    | WorkerUp
    | WorkerDown
    | Reported
    | Delivered
    | HandedBack
    | Tick
    | RouterChanged
    | LinkChanged
    | HandOut
)


@dataclass(frozen=True, slots=True)
class Start:
    """Record a new attempt, then assign it."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Resend:
    """Assign the same attempt again."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Revoke:
    """Cancel an attempt on its worker."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Record:
    """Keep the result of this attempt."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Acknowledge a result that is durable, or not needed."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class Requeue:
    """Record that an attempt ended because its worker ends."""

    worker: str
    attempt: Attempt


@dataclass(frozen=True, slots=True)
class OftenHandedBack:
    """Report that a rollout is handed back again and again, the last time by `worker`; it is tried all the same."""

    rollout: WorkId
    times: int
    worker: str
    host: str


@dataclass(frozen=True, slots=True)
class AwaitOther:
    """Report that a rollout waits at most so many seconds for a worker that has not tried it."""

    rollout: WorkId
    seconds: float


@dataclass(frozen=True, slots=True)
class Dismiss:
    """Tell a worker that leaves that it gets nothing more."""

    worker: str


@dataclass(frozen=True, slots=True)
class Fail:
    """Record that an attempt ended without a result."""

    worker: str
    attempt: Attempt
    failure: Failure


@dataclass(frozen=True, slots=True)
class EarlierFailure:
    """A failed attempt before a restart, and its host."""

    fail: Fail
    host: str


@dataclass(frozen=True, slots=True)
class GiveUp:
    """A worker hangs, or a rollout needs another process than its own: replace it if it is a local one."""

    worker: str


@dataclass(frozen=True, slots=True)
class Compared:
    """Record the digest of a result that is compared with others."""

    worker: str
    attempt: Attempt
    digest: str
    each: tuple[bytes, ...] = ()
    """As in `Opinion`."""


@dataclass(frozen=True, slots=True)
class Outvoted:
    """Record that a result differs from that of two others; nothing more of its worker counts."""

    worker: str
    attempt: Attempt
    digest: str


@dataclass(frozen=True, slots=True)
class Poison:
    """A rollout fails again and again: the campaign cannot continue."""

    rollout: WorkId
    failures: tuple[Fail, ...]


@dataclass(frozen=True, slots=True)
class SetAside:
    """A worker or a host gets nothing for so many seconds."""

    place: Place
    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class TakeBack:
    """A worker or a host that is set aside gets rollouts before its pause ends."""

    place: Place


Action = (
    Start
    | Resend
    | Revoke
    | Record
    | Acknowledge
    | Requeue
    | OftenHandedBack
    | AwaitOther
    | Dismiss
    | Fail
    | GiveUp
    | Compared
    | Outvoted
    | Poison
    | SetAside
    | TakeBack
)

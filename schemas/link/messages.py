"""The messages between the orchestrator and its workers; each one is validated and bounded."""

from functools import partial
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from ..base import Model
from ..batch import BatchRequest
from ..errors import MessageError, one_line, shortened
from ..failure import FailureKind
from ..ranges import MAX_FILE_BYTES, AttemptNumber, ProcessId, ProtocolNumber, Seconds, StepCount
from ..rollout import RolloutRequest, Sha256

PROTOCOL = 4
MAX_MESSAGE = 64 * 1024
"""Bytes of a JSON message."""
MAX_REQUEST = 2**20
"""Bytes of a message of the orchestrator, which may be the request for a batch."""
MAX_RESULT = MAX_FILE_BYTES
"""Bytes of one trajectory file."""

Rollout = Annotated[
    str,
    Field(
        pattern=r"^[a-z_]{1,40}\.(0|[1-9][0-9]{0,8})\.(nominal|true)\.(0|[1-9][0-9]{0,5})(\.[1-9][0-9]{0,3})?$",
        description="of a batch the name of its first rollout, and the number of all of them",
    ),
]
"""One text for each rollout: no leading zeros, and numbers in the ranges of `TestNumber` and `ReplicateNumber`."""
Key = Annotated[str, Field(max_length=200)]
"""Compared, never shown."""
Word = Annotated[Key, AfterValidator(one_line)]
Excerpt = Annotated[str, AfterValidator(shortened)]
"""Text of any length, of which 300 characters are kept as one line."""
Advice = Annotated[str, AfterValidator(partial(shortened, longest=2000))]
Secret = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Assign(Model):
    """Simulate this rollout."""

    type: Literal["assign"] = "assign"
    attempt: AttemptNumber
    secret: Secret = Field(description="of this attempt on this worker: with it the result is proved")
    request: RolloutRequest


class AssignBatch(Model):
    """Simulate this batch."""

    type: Literal["assign_batch"] = "assign_batch"
    attempt: AttemptNumber
    secret: Secret = Field(description="of this attempt on this worker: with it the result is proved")
    request: BatchRequest


class Cancel(Model):
    """Stop this attempt; its result is no longer needed."""

    type: Literal["cancel"] = "cancel"
    rollout: Rollout
    attempt: AttemptNumber


class Ack(Model):
    """The result of this attempt is durable (or not needed): drop it from the outbox."""

    type: Literal["ack"] = "ack"
    rollout: Rollout
    attempt: AttemptNumber


class Refuse(Model):
    """Refuse a worker that cannot serve this campaign; it leaves."""

    type: Literal["refuse"] = "refuse"
    reason: Advice


class Release(Model):
    """Nothing more is assigned to this worker, which has said that it leaves."""

    type: Literal["release"] = "release"


class RunFinished(Model):
    """The certificate of the campaign is issued: no rollout is needed any more, also not one under way."""

    type: Literal["finished"] = "finished"


class HeartbeatInterval(Model):
    """Send heartbeats at this interval from now on, and one after each change as before.

    A worker that does not know this message continues as before, and so does one that gets none.
    """

    type: Literal["heartbeat_interval"] = "heartbeat_interval"
    seconds: float = Field(ge=0.1, le=600)


Request = Assign | AssignBatch | Cancel | Ack | Refuse | Release | RunFinished | HeartbeatInterval


class WorkerState(Model):
    """Heartbeat: every half second or at the interval that the orchestrator has set, and soon after a change."""

    protocol: ProtocolNumber
    version: Word
    worker: Word
    host: Word
    platform: Word = Field(
        default="", description="class of CPU and C library, on which equal requests give equal bytes"
    )
    pid: ProcessId
    systems: dict[Key, Sha256] = Field(max_length=200, description="identity of each system")
    parts: dict[Key, tuple[Key, ...]] = Field(
        default_factory=dict,
        max_length=200,
        description="of each system with few of them, short digests of its files and packages",
    )
    state: Literal["idle", "busy"]
    rollout: Rollout | None = None
    attempt: AttemptNumber | None = None
    progress: StepCount = Field(default=0, description="control steps done; a worker that is not hung makes it grow")
    leaving: Literal[True] | None = Field(default=None, description="true if the worker takes no more rollouts")


class ResultHeader(Model):
    """Attachment of a result: the identity of the payload, or the reason why there is none."""

    rollout: Rollout
    attempt: AttemptNumber
    worker: Word
    outcome: Literal["done", "failed", "handed_back"] = Field(
        description="handed_back: the worker ends and has stopped the attempt, which says nothing about the rollout"
    )
    sha256: str = Field(default="", pattern=r"^([0-9a-f]{64})?$")
    error: Excerpt = ""
    kind: FailureKind | None = Field(default=None, description="of a failed attempt; if it is missing, infrastructure")
    cpu_seconds: Seconds = 0.0
    wall_seconds: Seconds = 0.0
    proof: str = Field(
        default="",
        pattern=r"^([0-9a-f]{64})?$",
        description="HMAC-SHA256 of the other fields by the assignment's secret",
    )

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if self.outcome != "failed" and self.kind is not None:
            raise ValueError("only a failed attempt has a kind of failure")
        return self


T = TypeVar("T")
_REQUEST: TypeAdapter[Request] = TypeAdapter(
    Annotated[Request, Field(discriminator="type")], config=ConfigDict(cache_strings="keys")
)
_STATE = TypeAdapter(WorkerState)
_HEADER = TypeAdapter(ResultHeader)


def encode_message(message: Model) -> bytes:
    """Return the JSON of a message."""
    return message.model_dump_json(exclude_none=True).encode()


def decode_request(payload: bytes) -> Request:
    """Read a message of the orchestrator.

    Raises:
        MessageError: it is too large or not of the protocol.

    """
    return _validated(_REQUEST, payload, MAX_REQUEST)


def decode_state(payload: bytes) -> WorkerState:
    """Read a heartbeat; raises `MessageError`."""
    return _validated(_STATE, payload)


def decode_header(payload: bytes) -> ResultHeader:
    """Read the attachment of a result; raises `MessageError`."""
    return _validated(_HEADER, payload)


def _validated(adapter: TypeAdapter[T], payload: bytes, most: int = MAX_MESSAGE) -> T:
    if len(payload) > most:
        raise MessageError(f"{len(payload)} bytes are more than the {most} of a message")
    try:
        return adapter.validate_json(payload)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        # A key of the message may be part of the place.
        raise MessageError(shortened(f"{where}: {first['msg']}" if where else first["msg"])) from None


# Heartbeats. Their interval is 0.5 s times a power of two: the shortest one at which the whole fleet sends at most
# `MOST` a second, but never more than a third of `hung_after`, so that two in a row may be lost before a worker counts
# as hung. A lost worker is found by its liveliness token, whatever the interval.

HEARTBEAT = 0.5
"""Seconds between two heartbeats of a worker that got no other interval, and before one after a change that lasts."""
MOST = 250
"""Heartbeats of a fleet in a second, some hundredths of a core of the orchestrator; more where h is too short."""


def heartbeat_interval(workers: int, hung_after: float) -> float:
    """Return the seconds between two heartbeats of each of `workers` workers.

    >>> [heartbeat_interval(workers, hung_after=60.0) for workers in (1, 125, 126, 1000, 10_000)]
    [0.5, 0.5, 1.0, 4.0, 16.0]
    >>> heartbeat_interval(1000, hung_after=10.0)
    2.0
    """
    interval = HEARTBEAT
    # Powers of two: a worker that comes or goes seldom changes the interval of all others.
    while workers > MOST * interval and 2 * interval <= hung_after / 3:
        interval *= 2
    return interval


def is_near(interval: float, wanted: float) -> bool:
    """Whether a worker may keep its interval, which is not too short, and not more than twice the wanted one.

    Without that margin one worker that comes and goes would change the interval of all others each time.
    """
    return wanted <= interval <= 2 * wanted

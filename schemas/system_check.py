"""The exchange between `check-system` and its child processes: rollouts, and what was measured of each."""

from typing import Literal

from pydantic import Field

from .base import Model
from .batch import BatchRequest
from .rollout import RolloutRequest
from .values import Stamps


class Trial(Model):
    """One rollout of a check.

    `reseed` is the seed of the global random states (`random`, `numpy.random`) set before it; None leaves them.
    `beginning` is the length in s of the part of the trajectory that gets a digest of its own, `pause` the time in s
    before the rollout. With a `batch`, whose first rollout is the request, the batch is simulated and compared.
    """

    request: RolloutRequest
    reseed: int | None = None
    beginning: float = 0.0
    pause: float = 0.0
    batch: BatchRequest | None = None


Against = Literal["again", "others", "alone", "order"]
"""With what a batch is compared: itself, with other starts in half of its places, its rollouts alone, another order."""


class BatchDifference(Model):
    """The difference of a batch from another one: of `rollouts`, and where it is largest, in the unit of the column."""

    against: Against
    rollouts: int
    place: int
    column: str
    time: float
    distance: float


class Acts(Model):
    """What a policy or a controller did in a rollout that may be a mistake: in words, empty where it is none."""

    outside: str = Field(default="", description="the first action outside its range")
    idle: str = Field(default="", description="how no actuator was set in the whole rollout")


class SampleTimes(Model):
    """The sample times of a trajectory, in s; the steps of a single sample are 0.

    `least_step` leaves out the last step: it may be shorter, so that the last sample is at the horizon.
    """

    samples: int
    first: float
    last: float
    least_step: float
    greatest_step: float
    stamps: Stamps = Field(default="exact", description="of what kind the times are")
    uncovered: str = Field(default="", description="in what they do not cover 0 to the horizon")


class Measured(Model):
    """One line of the child: after it has loaded the system, without a rollout, then after each rollout.

    A rollout with an `error` has no digests and no grid. `place` is the file and the line of the user's code.
    """

    error: str = ""
    raised: bool = Field(
        default=False, description="the error comes from the system, and not from a check of perfbound"
    )
    place: str = ""
    file_sha256: str = ""
    samples_sha256: str = ""
    beginning_sha256: str = ""
    file_bytes: int = 0
    grid: SampleTimes | None = None
    reported: tuple[float, ...] = Field(default=(), description="disturbances that the rollout reports")
    acts: Acts | None = Field(default=None, description="of a system with a policy or a controller")
    seconds: float = Field(default=0.0, description="of the rollout, or of one more rollout of a batch")
    differences: tuple[BatchDifference, ...] = Field(default=(), description="of a batch")
    memory: int = Field(default=0, description="bytes of the process and those it started in memory, after the rollout")
    peak: int = Field(default=0, description="the largest number of these bytes so far")
    printed: int = Field(default=0, description="bytes that were printed to stdout")
    reseeded: tuple[str, ...] = Field(default=(), description="global random states that the rollout changed")
    threads: tuple[str, ...] = Field(default=(), description="names of the threads that are there since the start")
    tasks: int = Field(default=0, description="threads of the process, those of libraries included")
    processes: tuple[str, ...] = Field(default=(), description="names of processes that run on after the rollout")
    undeclared: tuple[str, ...] = Field(
        default=(), description="files that were read so far and are no part of the system"
    )
    packages: tuple[str, ...] = Field(
        default=(), description="distributions that were imported and are no part of the system; after the last rollout"
    )
    files: tuple[str, ...] = Field(
        default=(), description="entries of the working and of the temporary directory that the rollout has made"
    )


class ChildRun(Model):
    """The rollouts of one child process, in their order; those that it did not reach have no measurement."""

    trials: tuple[Trial, ...]
    loaded: Measured | None = Field(description="after loading; None if the process ended before")
    measured: tuple[Measured, ...]
    ended: str = Field(default="", description="how it ended early, in words; empty if it did not")
    hung: bool = False
    place: str = Field(default="", description="where it ended early: file and line")
    stderr: str = Field(default="", description="the last line on stderr of a process that ended early")
    printed: str = Field(default="", description="the beginning of what was printed to stdout")

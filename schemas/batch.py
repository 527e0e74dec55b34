"""The request for a batch: rollouts of one variant, of one test or of consecutive ones, that are simulated together."""

import json
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .base import Model
from .file.signals import SignalShape
from .ids import FileId, RolloutId, WorkId
from .ranges import LARGEST_BATCH, MAX_FILE_BYTES, ReplicateNumber, Seconds, Seed, TestNumber
from .rollout import (
    MAX_PARAMETERS,
    Disturbances,
    Name,
    RolloutRequest,
    Sha256,
    Start,
    Whole,
    check_disturbances,
    disturbances_of_batch,
    start_of_campaign,
)
from .system import OptionValue, SystemSpec, Variant

MOST_NUMBERS = 30_000
"""Numbers of all starts and disturbances of a batch, so that its request stays a message of less than a megabyte."""
SPARE_BYTES = 2**20
"""Of a file, for what is beside its trajectories."""


class BatchRequest(Model):
    """A batch: replicates `replicate` and the following ones, of test `test` and of the following ones.

    The rollouts are in the order of the tests, and within a test in that of the replicates. `x` has the start of each
    test, `seeds` the seed of each rollout; everything else is as in `RolloutRequest`.
    """

    campaign: Name
    config_sha256: Sha256
    problem: str = Field(pattern=r"^[a-z_]{1,40}$")
    test: TestNumber
    variant: Variant
    replicate: ReplicateNumber
    replicates: int = Field(ge=1, le=LARGEST_BATCH, description="of each test")
    seeds: tuple[Seed, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    system: Name
    spec_sha256: Sha256
    options: dict[str, OptionValue] = Field(default_factory=dict)
    x: tuple[Start, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    horizon: Seconds
    signals: tuple[SignalShape, ...] = Field(default=(), max_length=MAX_PARAMETERS)
    disturbances: tuple[Disturbances, ...] = disturbances_of_batch()
    start: tuple[Whole, ...] = start_of_campaign(most=LARGEST_BATCH)

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if len(self.seeds) != len(self.x) * self.replicates:
            raise ValueError(f"{len(self.seeds)} seeds for {len(self.x)} starts with {self.replicates} rollouts each")
        check_disturbances(self.disturbances, len(self.seeds))
        if len(set(map(len, self.x))) != 1:
            raise ValueError("the starts differ in length")
        numbers = len(self.x) * len(self.x[0]) + sum(map(len, (*self.disturbances, *self.start)))
        if numbers > MOST_NUMBERS:
            raise ValueError(f"starts and disturbances have {numbers} numbers together, more than {MOST_NUMBERS}")
        return self

    def __len__(self) -> int:
        return len(self.seeds)

    @property
    def rollout(self) -> str:
        """Name of the batch: of its first rollout, with the number of all of them."""
        return str(file_of(self))

    @property
    def rollouts(self) -> list[RolloutId]:
        """Every rollout, in their order."""
        first = RolloutId(self.problem, self.test, self.variant, self.replicate)
        return batch_rollouts(first, len(self.x), self.replicates)

    @property
    def chosen(self) -> tuple[tuple[float, ...], ...]:
        """The start of each test as the campaign has it."""
        return self.start or self.x

    @cached_property
    def starts(self) -> NDArray[np.float64]:
        """The start of each rollout, shape (R, p), in the units of the parameters."""
        return np.repeat(np.array(self.x), self.replicates, axis=0)

    @cached_property
    def drawn(self) -> NDArray[np.float64]:
        """The disturbances of each rollout, shape (R, k)."""
        return np.array(self.disturbances or ((),) * len(self))

    def single(self, place: int) -> RolloutRequest:
        """Return the request for one of the rollouts alone."""
        test, number = divmod(place, self.replicates)
        common = self.model_dump(
            exclude={"test", "replicate", "replicates", "seeds", "x", "signals", "disturbances", "start"}
        )
        return RolloutRequest(
            **common,
            test=self.test + test,
            replicate=self.replicate + number,
            seed=self.seeds[place],
            x=self.x[test],
            signals=self.signals,
            disturbances=self.disturbances[place] if self.disturbances else (),
            start=self.start[test] if self.start else (),
        )

    @property
    def metadata(self) -> dict[str, str]:
        """The metadata record of the batch's file."""
        named = {name: getattr(self, name) for name in ("campaign", "problem", "variant", "system", "config_sha256")}
        return {**named, "first": str(self.rollouts[0]), "rollouts": str(len(self))}


def batch_rollouts(first: RolloutId, tests: int, replicates: int) -> list[RolloutId]:
    """Return the rollouts of a batch: so many replicates of each of so many tests, from `first` on."""
    problem, test, variant, replicate = first
    numbers = range(replicate, replicate + replicates)
    return [RolloutId(problem, each, variant, number) for each in range(test, test + tests) for number in numbers]


def read_request(text: str) -> RolloutRequest | BatchRequest:
    """Read the JSON of a request for a rollout or for a batch; raises pydantic's ValidationError."""
    try:
        found = json.loads(text)
    except ValueError:
        found = None
    # By its own key: a rollout within a batch has seeds as well, and an option may have any name.
    is_batch = isinstance(found, dict) and "replicates" in found
    return (BatchRequest if is_batch else RolloutRequest).model_validate_json(text)


def file_of(request: RolloutRequest | BatchRequest) -> FileId:
    """Return the file of the rollout or of the batch that is requested."""
    first = RolloutId(request.problem, request.test, request.variant, request.replicate)
    return FileId(first, len(request)) if isinstance(request, BatchRequest) else FileId(first)


def work_of(request: RolloutRequest | BatchRequest) -> WorkId:
    """Return the rollout or the batch that is requested."""
    found = file_of(request)
    return found if found.places else found.rollout


def alone(request: RolloutRequest | BatchRequest) -> RolloutRequest:
    """Return the request for a rollout, or for the first one of a batch."""
    return request.single(0) if isinstance(request, BatchRequest) else request


def largest_batch(trajectory_bytes: int) -> int:
    """Return the largest `batch` for rollouts whose trajectories have so many bytes each; 0 for none.

    >>> largest_batch(4000), largest_batch(2**20)
    (1024, 63)
    """
    return min((MAX_FILE_BYTES - SPARE_BYTES) // max(trajectory_bytes, 1), LARGEST_BATCH)


def largest_result(spec: SystemSpec, request: RolloutRequest | BatchRequest) -> int:
    """Return the bytes of the largest file that is accepted for a request."""
    return min(spec.largest_file * (len(request) if isinstance(request, BatchRequest) else 1), MAX_FILE_BYTES)

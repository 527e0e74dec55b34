"""The trajectories of a batch on one time grid, and their file.

A file contains the evidence alone: attachments `request.json`, `time.npy` (the grid once), `trajectory.npy` (column x
rollout x time in one array, which costs a fifth of an attachment for each rollout) and, where rollouts have failed,
`failures.json` with their reasons; their samples are zeros.

| symbol | meaning | shape |
|---|---|---|
| T | samples of each rollout | |
| R | rollouts | |
| n | columns, the first one is the time `t` | |
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from ..base import canonical_json
from ..batch import BatchRequest
from ..errors import TrajectoryError, UnusableTrajectoryError, shortened
from ..ids import RolloutId
from ..instants import disorder
from ..ranges import LARGEST_BATCH
from .canonical import EVIDENCE, FAILURES, OF_BATCH, REQUEST, TIME, Layout, canonical_evidence, canonical_file
from .file_checks import check_checksums, check_length, check_sizes
from .npy import from_npy, to_npy
from .trajectory import MALFORMED, File, Trajectory, check_columns, check_finite
from .visual import Floats


@dataclass(frozen=True, eq=False)
class Batch:
    """The trajectories of R rollouts on one time grid; the arrays become read-only.

    `failures` has the reason of each rollout that has no trajectory, by its place.

    Raises:
        ValueError: a shape is wrong, a number is not finite, the time decreases, or no rollout has a trajectory.

    """

    columns: tuple[str, ...]
    time: Floats  # (T,), s
    values: Floats  # (n - 1, R, T)
    failures: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_columns(self.columns)
        for array in (self.time, self.values):
            array.flags.writeable = False
        shape = self.values.shape
        if self.time.ndim != 1 or len(shape) != 3 or shape[::2] != (len(self.columns) - 1, len(self.time)):
            raise ValueError(f"times have shape {self.time.shape}, values {shape}, for {len(self.columns)} columns")
        if not 0 < shape[1] <= LARGEST_BATCH or not shape[2]:
            raise ValueError(f"a batch has 1 to {LARGEST_BATCH} rollouts of one sample at least, not shape {shape}")
        if not set(self.failures) <= set(range(shape[1])) or len(self.failures) == shape[1]:
            raise ValueError("failures are those of some of the rollouts, by their places")
        failed = list(self.failures)
        if failed and self.values[:, failed].any():
            raise ValueError("the samples of a failed rollout are zeros")
        if not (np.isfinite(self.values).all() and np.isfinite(self.time).all()):
            self._raise_first()
        self._check_order()

    def _check_order(self) -> None:
        if len(self.time) > 1 and not (np.diff(self.time) > 0.0).all():
            # Rows of one time are a jump, and may change once: a matter of the values of each rollout.
            for place in self.succeeded:
                if fault := disorder(self._samples(place)):
                    raise ValueError(f"rollout {place}: {fault}")
        elif fault := disorder(self.time[:, np.newaxis]):
            raise ValueError(fault)

    def _raise_first(self) -> None:
        for place in self.succeeded:
            try:
                check_finite(self._samples(place), self.columns)
            except ValueError as error:
                raise ValueError(f"rollout {place}: {error}") from None

    def __len__(self) -> int:
        return int(self.values.shape[1])

    @property
    def succeeded(self) -> list[int]:
        """The places of the rollouts that have a trajectory."""
        return [place for place in range(len(self)) if place not in self.failures]

    def trajectory(self, place: int) -> Trajectory:
        """Return the trajectory of one rollout.

        Raises:
            KeyError: it has failed.

        """
        if place in self.failures:
            raise KeyError(f"rollout {place} of the batch failed: {self.failures[place]}")
        return Trajectory(self.columns, self._samples(place))

    def _samples(self, place: int) -> Floats:
        return np.column_stack((self.time, self.values[:, place].T))

    @cached_property
    def digests(self) -> tuple[bytes, ...]:
        """The sha256 of every rollout, of its times and samples alone, so that no file and no batch decides it.

        That of a failed one is empty.
        """
        return tuple(self._digests())

    def _digests(self) -> Iterator[bytes]:
        grid = hashlib.sha256(self.time.tobytes())
        by_rollout = np.ascontiguousarray(self.values.transpose(1, 0, 2))
        for place in range(len(self)):
            if place in self.failures:
                yield b""
                continue
            found = grid.copy()
            found.update(memoryview(by_rollout[place]).cast("B"))
            yield found.digest()


def digest_of(trajectory: Trajectory) -> bytes:
    """Return the digest of a rollout, which is the same alone and in a batch, see `Batch.digests`."""
    # Column after column, the time first: two trajectories of one system share it if they agree in every bit.
    return hashlib.sha256(np.ascontiguousarray(trajectory.samples.T).tobytes()).digest()


class Trajectories(Protocol):
    """A batch whose rollouts are addressed by their places."""

    def trajectory(self, place: int) -> Trajectory:
        """Return the trajectory of one rollout; raises KeyError where there is none."""
        ...


Content = TypeVar("Content", bound=Trajectories)


class BatchFile(NamedTuple, Generic[Content]):
    """The content of a batch's file; `request` is the JSON text."""

    batch: Content
    request: bytes
    metadata: dict[str, str]

    def place(self, rollout: RolloutId) -> int:
        """Return the place of a rollout in the batch; raises ValueError if it is not there."""
        return self.requested.rollouts.index(rollout)

    def alone(self, rollout: RolloutId) -> File:
        """Return one rollout with the request and the metadata that its own file would have.

        Raises:
            TrajectoryError: it has failed, is not in the batch, or its samples were not kept.

        """
        try:
            place = self.place(rollout)
            request = self.requested.single(place)
            return File(self.batch.trajectory(place), request.model_dump(mode="json"), request.metadata)
        except (KeyError, ValueError) as error:
            raise TrajectoryError(f"{rollout} is not in the file of its batch: {error.args[0]}") from None

    @property
    def requested(self) -> BatchRequest:
        """The request."""
        return _parsed(self.request)


@lru_cache(maxsize=4)
def _parsed(request: bytes) -> BatchRequest:
    return BatchRequest.model_validate_json(request)


def encode_batch(batch: Batch, *, request: Mapping[str, Any], metadata: Mapping[str, str]) -> bytes:
    """Return the batch's file: equal arguments give equal bytes; raises ValueError for a number that is not finite."""
    attachments = {
        REQUEST: canonical_json(dict(request)).encode(),
        TIME: to_npy(batch.time),
        EVIDENCE: to_npy(batch.values),
    }
    if batch.failures:
        attachments[FAILURES] = failures_text(batch.failures)
    return canonical_file(OF_BATCH, {**metadata, "columns": json.dumps(batch.columns)}, attachments)


def read_batch(data: bytes) -> BatchFile[Batch]:
    """Return the content of the one file that `encode_batch` writes for it.

    Every byte is covered by a checksum that is verified here, and nothing larger than the file is allocated.

    Raises:
        UnusableTrajectoryError: the file is intact, but `Batch` refuses its content.
        TrajectoryError: it is damaged, cut, too large, incomplete or written otherwise.

    """
    try:
        found = read_parts(data, OF_BATCH)
        try:
            batch = Batch(found.columns, found.time, found.values, found.failures)
        except ValueError as error:
            raise UnusableTrajectoryError(f"not a usable batch: {error}") from None
        return BatchFile(batch, found.attachments[REQUEST], found.metadata)
    except MALFORMED as error:
        raise TrajectoryError(f"not a batch's file: {type(error).__name__}: {error}") from error


class Parts(NamedTuple):
    """What the file of every batch has, reduced or not."""

    columns: tuple[str, ...]
    time: Floats
    values: Floats
    failures: dict[int, str]
    metadata: dict[str, str]
    attachments: dict[str, bytes]


def read_parts(data: bytes, layout: Layout) -> Parts:
    """Read the file of a batch; raises TrajectoryError, or one of `MALFORMED`, for what is no such file."""
    check_checksums(data)
    check_sizes(data, arrays=2)  # the times as well
    metadata, attachments = canonical_evidence(data, layout, visual=False)
    columns = json.loads(metadata["columns"])
    if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
        raise TrajectoryError("the columns are not a list of names")
    check_length(REQUEST, attachments[REQUEST])
    failures = _failures(attachments.get(FAILURES))
    arrays = from_npy(TIME, attachments[TIME], 1), from_npy(EVIDENCE, attachments[EVIDENCE], 3)
    return Parts(tuple(columns), *arrays, failures, metadata, attachments)


def with_failures(data: bytes, failures: Mapping[int, str]) -> bytes:
    """Return the file of the same batch in which these rollouts have failed; raises as `read_batch`."""
    batch, request, metadata = read_batch(data)
    values = batch.values.copy()
    values[:, list(failures)] = 0.0
    failed = Batch(batch.columns, batch.time, values, failures)
    return encode_batch(failed, request=json.loads(request), metadata=metadata)


def failures_text(failures: Mapping[int, str]) -> bytes:
    """Return the attachment with place and reason of each failed rollout."""
    return canonical_json([[place, shortened(reason)] for place, reason in sorted(failures.items())]).encode()


def _failures(content: bytes | None) -> dict[int, str]:
    """Read what `failures_text` has written; raises `TrajectoryError` for anything else."""
    if content is None:
        return {}
    check_length(FAILURES, content)
    listed = json.loads(content)
    if not isinstance(listed, list) or not all(isinstance(each, list) and len(each) == 2 for each in listed):
        raise TrajectoryError(f"{FAILURES} is no list of places with their reasons")
    found = {place: reason for place, reason in listed if type(place) is int and type(reason) is str}
    if not found or failures_text(found) != content:
        raise TrajectoryError(f"{FAILURES} is not written as perfbound writes it")
    return found

"""A batch of which only some rollouts keep their samples, and its file.

Of each rollout the file has the digest of its samples and its scores, so that what is claimed can be repeated:
attachments `request.json`, `time.npy`, `kept.json` (the places of those that keep their samples), `trajectory.npy`
(column x kept rollout x time), `digests.bin` (32 bytes each), `scores.npy` (robustness, mark of the tolerance, early
end) and, where rollouts have failed, `failures.json`.

| symbol | meaning |
|---|---|
| R | rollouts |
| K | those of them that keep their samples |
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base import canonical_json
from ..errors import TrajectoryError, UnusableTrajectoryError
from ..ranges import DIGEST, LARGEST_BATCH
from .batch import Batch, BatchFile, failures_text, read_batch, read_parts
from .canonical import (
    DIGESTS,
    EVIDENCE,
    FAILURES,
    KEPT,
    OF_REDUCED,
    REQUEST,
    SCORES,
    TIME,
    canonical_file,
    is_of,
)
from .file_checks import check_length
from .npy import from_npy, to_npy
from .trajectory import MALFORMED, Trajectory
from .visual import Floats


class Scores(NamedTuple):
    """What is recorded of the R rollouts of a batch beside their samples."""

    robustness: Floats | None
    """Shape (R,), clipped, NaN for a failed rollout; None for a campaign that measures none."""
    by_tolerance: NDArray[np.bool_]
    """Whether the tolerance of the time stamps could decide a sign, shape (R,)."""
    ended: Floats
    """When each rollout ended before the horizon, in s, shape (R,); NaN for one that did not."""
    failures: Mapping[int, str]
    """Place and reason of each rollout without a score, those without a trajectory included."""

    @property
    def rows(self) -> Floats:
        """Robustness, mark and end of each rollout, shape (3, R)."""
        return np.array([self.robustness, self.by_tolerance, self.ended], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Reduced:
    """A batch of which the rollouts in `kept` have their samples, in this order.

    Raises:
        ValueError: a shape is wrong, a number is not finite, or a place is not that of a rollout.

    """

    columns: tuple[str, ...]
    time: Floats  # (T,), s
    kept: tuple[int, ...]
    values: Floats  # (n - 1, K, T)
    digest_column: bytes  # DIGEST bytes for each rollout; zeros for one that has failed
    scores: Scores

    def __post_init__(self) -> None:
        count = len(self)
        if not 0 < count <= LARGEST_BATCH or len(self.digest_column) != DIGEST * count:
            raise ValueError(f"a batch has 1 to {LARGEST_BATCH} rollouts, each with a digest, not {count}")
        if not (set(self.failures) < set(range(count)) and set(self.kept) <= set(self.succeeded)):
            raise ValueError("kept and failed ones are not rollouts of the batch, or one of them is both")
        if list(self.kept) != sorted(set(self.kept)) or self.values.shape[1:2] != (len(self.kept),):
            raise ValueError(f"{len(self.kept)} kept rollouts, not in their order or with other samples")
        failed = [place in self.failures for place in range(count)]
        robustness = self.scores.robustness
        if robustness is None or not np.array_equal(~np.isfinite(robustness), failed):
            raise ValueError("a rollout has no robustness, or a failed one has")
        if any((self._digest(place) == bytes(DIGEST)) != failed[place] for place in range(count)):
            raise ValueError("a rollout has no digest, or a failed one has")
        # One that nothing is kept of is no `Batch`, and has nothing to check.
        found = self.samples.digests if self.samples is not None else ()
        for place, digest in zip(self.kept, found, strict=True):
            if digest != self._digest(place):
                raise ValueError(f"the samples of rollout {place} have another digest")

    def __len__(self) -> int:
        return len(self.scores.ended)

    @property
    def failures(self) -> Mapping[int, str]:
        """The reason of each rollout that has no trajectory, or no score, by its place."""
        return self.scores.failures

    @cached_property
    def samples(self) -> Batch | None:
        """The kept rollouts, a batch of their own; None without one."""
        return Batch(self.columns, self.time, self.values) if self.kept else None

    @property
    def succeeded(self) -> list[int]:
        """The places of the rollouts that had a trajectory."""
        return [place for place in range(len(self)) if place not in self.failures]

    def trajectory(self, place: int) -> Trajectory:
        """Return the trajectory of one rollout.

        Raises:
            KeyError: it has failed, or its samples were not kept.

        """
        if place in self.failures:
            raise KeyError(f"rollout {place} of the batch failed: {self.failures[place]}")
        if place not in self.kept:
            raise KeyError("its samples were not kept (key `keep`)")
        return Trajectory(self.columns, np.column_stack((self.time, self.values[:, self.kept.index(place)].T)))

    @property
    def digests(self) -> tuple[bytes, ...]:
        """The digest of every rollout, as `Batch.digests`."""
        return tuple(b"" if place in self.failures else self._digest(place) for place in range(len(self)))

    def _digest(self, place: int) -> bytes:
        return self.digest_column[DIGEST * place : DIGEST * (place + 1)]


def reduced(batch: Batch, kept: Sequence[int], scores: Scores) -> Reduced:
    """Return a batch with the samples of `kept` alone."""
    digests = [bytes(DIGEST) if place in scores.failures else each for place, each in enumerate(batch.digests)]
    values = np.ascontiguousarray(batch.values[:, list(kept)])
    return Reduced(batch.columns, batch.time, tuple(kept), values, b"".join(digests), scores)


def encode_reduced(batch: Reduced, *, request: Mapping[str, Any], metadata: Mapping[str, str]) -> bytes:
    """Return the file of a reduced batch: equal arguments give equal bytes."""
    attachments = {
        REQUEST: canonical_json(dict(request)).encode(),
        TIME: to_npy(batch.time),
        KEPT: canonical_json(list(batch.kept)).encode(),
        EVIDENCE: to_npy(batch.values),
        DIGESTS: batch.digest_column,
        SCORES: to_npy(batch.scores.rows),
    }
    if batch.failures:
        attachments[FAILURES] = failures_text(batch.failures)
    return canonical_file(OF_REDUCED, {**metadata, "columns": json.dumps(batch.columns)}, attachments)


def reduced_file(data: bytes, kept: Sequence[int], scores: Scores) -> bytes:
    """Return the file of the same batch as `reduced` leaves it; raises as `read_batch`."""
    batch, request, metadata = read_batch(data)
    return encode_reduced(reduced(batch, kept, scores), request=json.loads(request), metadata=metadata)


def read_reduced(data: bytes) -> BatchFile[Reduced]:
    """Return the content of the one file that `encode_reduced` writes for it; raises as `read_batch`."""
    try:
        columns, time, values, failures, metadata, attachments = read_parts(data, OF_REDUCED)
        kept, scores = _kept(attachments[KEPT]), _scores(attachments[SCORES], failures)
        try:
            batch = Reduced(columns, time, kept, values, attachments[DIGESTS], scores)
        except ValueError as error:
            raise UnusableTrajectoryError(f"not a usable batch: {error}") from None
        return BatchFile(batch, attachments[REQUEST], metadata)
    except MALFORMED as error:
        raise TrajectoryError(f"not the file of a reduced batch: {type(error).__name__}: {error}") from error


def read_stored(data: bytes) -> BatchFile[Batch] | BatchFile[Reduced]:
    """Return the content of a batch's file, reduced or not; raises as `read_batch`."""
    return read_reduced(data) if is_of(OF_REDUCED, data) else read_batch(data)


def _kept(content: bytes) -> tuple[int, ...]:
    check_length(KEPT, content)
    found = json.loads(content)
    if not isinstance(found, list) or not all(type(each) is int for each in found):
        raise TrajectoryError(f"{KEPT} is no list of places")
    if canonical_json(found).encode() != content:
        raise TrajectoryError(f"{KEPT} is not written as perfbound writes it")
    return tuple(found)


def _scores(content: bytes, failures: Mapping[int, str]) -> Scores:
    found = from_npy(SCORES, content, 2)
    if len(found) != 3 or not np.isin(found[1], (0.0, 1.0)).all():
        raise TrajectoryError(f"{SCORES} has other rows than robustness, mark and end")
    return Scores(found[0], found[1] == 1.0, found[2], failures)

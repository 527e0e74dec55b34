"""The trajectory and its file.

A file contains the evidence (attachment `trajectory.npy`, attachment `request.json`, one metadata record) and, if the
trajectory has a `Visual`, a visual part: at 30 Hz (channels /tf, /scene, /solids, /state and /log), or one channel
of numbers for each column. Nothing in it depends on the clock or the host: the same rollout gives the same
bytes.

| symbol | meaning | shape, unit |
|---|---|---|
| T | samples of a trajectory | |
| n | columns, the first one is the time `t` | |
| F | frames of the visual part, 30 per second | |
"""

import copy
import io
import itertools
import json
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Attachment, DataEnd, McapRecord, Metadata
from mcap.records import Chunk as ReadChunk
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from ..base import canonical_json
from ..errors import TrajectoryError, UnusableTrajectoryError
from ..instants import disorder
from ..real_numbers import real_array
from . import plots
from .canonical import (
    EVIDENCE,
    OF_ROLLOUT,
    REQUEST,
    Evidence,
    canonical_evidence,
    canonical_file,
    evidence_of,
)
from .chunks import Chunk, channel_record, chunked, seen_file, type_record
from .file_checks import check_checksums, check_length, check_sizes
from .npy import from_npy, to_npy
from .visual import Floats, Transform, Visual

__all__ = [
    "File",
    "Floats",
    "Trajectory",
    "TrajectoryError",
    "Transform",
    "Visual",
    "decode",
    "encode",
    "read_canonical",
    "read_mcap",
]

FRAME_RATE = 30  # 1/s
PLOT_LEVEL = -1  # of zstd: two thirds of the time of its default, and here 7 % smaller

MALFORMED = (McapError, ValueError, KeyError, struct.error, OverflowError, RecursionError, MemoryError)
"""What the readers raise for bytes that are no file."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The columns of one rollout over time; `samples` becomes float64, C order and read-only.

    Raises:
        ValueError: the first column is not `t`, a name is double, the shape is wrong, a number is not finite, or the
            time is negative or decreases. Equal times are a jump, and have two states.

    """

    columns: tuple[str, ...]
    samples: Floats  # (T, n)
    visual: Visual | None = None

    def __post_init__(self) -> None:
        try:
            samples = np.array(real_array(self.samples), order="C")
        except ValueError as error:
            raise ValueError(f"samples: an array that {error}") from None
        samples.flags.writeable = False
        object.__setattr__(self, "samples", samples)
        check_columns(self.columns)
        _check_samples(samples, self.columns)
        self._check_frames()

    def _check_frames(self) -> None:
        for transform in self.visual.transforms if self.visual else ():
            if len(transform) != len(self.frames):
                raise ValueError(f"transform {transform.child} has {len(transform)} frames, not {len(self.frames)}")

    def showing(self, visual: Visual) -> "Trajectory":
        """Return this trajectory with a visual part.

        Raises:
            ValueError: a transform has another number of frames.

        """
        shown = copy.copy(self)  # without a second check of the samples, which are read-only
        object.__setattr__(shown, "visual", visual)
        shown._check_frames()
        return shown

    def __repr__(self) -> str:
        """Return the number of samples, their times, and the columns."""
        t = self.samples[:, 0]
        return f"<Trajectory of {len(t)} samples, {t[0]:g} to {t[-1]:g} s: {', '.join(self.columns[1:])}>"

    def column(self, name: str) -> Floats:
        """Return one column, shape (T,).

        Raises:
            KeyError: there is no such column.

        """
        if name not in self.columns:
            raise KeyError(f"no column {name!r}; there are {', '.join(self.columns)}")
        return self.samples[:, self.columns.index(name)]

    @property
    def frames(self) -> NDArray[np.intp]:
        """Rows of the visual part: the first one at or after each 1/30 s, shape (F,)."""
        t = self.samples[:, 0]
        count = int((t[-1] - t[0]) * FRAME_RATE + 1e-6) + 1
        wanted = t[0] + np.arange(count) / FRAME_RATE
        rows: NDArray[np.intp] = np.minimum(np.searchsorted(t, wanted - 1e-9), len(t) - 1)
        return rows


@dataclass(frozen=True, eq=False)
class File:
    """The content of a trajectory's file, without its visual part."""

    trajectory: Trajectory
    request: dict[str, Any]
    metadata: dict[str, str]


def encode(
    trajectory: Trajectory, *, request: Mapping[str, Any], metadata: Mapping[str, str], units: Mapping[str, str]
) -> bytes:
    """Return the trajectory's file: equal arguments give equal bytes.

    `units` names the unit of each column; the metadata record is `metadata` and the list of columns.

    Raises:
        ValueError: `request` contains a number that is not finite, `units` lacks a column, or the name of a visible
            column is no name of a protobuf field.

    """
    if missing := set(trajectory.columns) - set(units):
        raise ValueError(f"no unit for {', '.join(sorted(missing))}")
    visual = trajectory.visual
    record = {**metadata, "columns": json.dumps(trajectory.columns)}
    attachments = {REQUEST: canonical_json(dict(request)).encode(), EVIDENCE: to_npy(trajectory.samples)}
    if visual is None:
        return canonical_file(OF_ROLLOUT, record, attachments)
    evidence = evidence_of(OF_ROLLOUT, record, attachments)
    if visual.plots:
        definitions, found = _plotted(trajectory, units)
        return seen_file(*evidence, definitions, [found], level=PLOT_LEVEL, offsets=False)
    return seen_file(*evidence, *_drawn(trajectory, visual, units))


def decode(data: bytes) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        TrajectoryError: as `read_mcap`.

    """
    return read_mcap(data).trajectory


def read_canonical(data: bytes, *, visual: bool) -> File:
    """Return the evidence in the one file that `encode` writes for it; with `visual` it may have a visual part.

    Raises:
        TrajectoryError: as `read_mcap`, or the file is written otherwise.

    """
    return _file_of(data, lambda whole: canonical_evidence(whole, OF_ROLLOUT, visual=visual), canonical=True)


def read_mcap(data: bytes) -> File:
    """Return the evidence in a trajectory's file, without its visual part.

    Every byte is covered by a checksum that is verified here, and nothing larger than the file is allocated.

    Raises:
        UnusableTrajectoryError: the file is intact, but `Trajectory` refuses its content.
        TrajectoryError: the file is damaged, cut, too large or incomplete.

    """
    return _file_of(data, _evidence_records)


def _file_of(data: bytes, evidence: Callable[[bytes], Evidence], *, canonical: bool = False) -> File:
    try:
        check_checksums(data)
        check_sizes(data)
        record, attachments = evidence(data)
        columns = json.loads(record["columns"])
        if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
            raise TrajectoryError("the columns are not a list of names")
        if canonical and record["columns"] != json.dumps(columns):
            raise TrajectoryError("the list of columns is not written as perfbound writes it")
        check_length(REQUEST, attachments[REQUEST])
        request = json.loads(attachments[REQUEST])
        if not isinstance(request, dict) or canonical_json(request).encode() != attachments[REQUEST]:
            raise TrajectoryError(f"{REQUEST} is not an object, written as perfbound writes it")
        return File(_usable(tuple(columns), from_npy(EVIDENCE, attachments[EVIDENCE], 2)), request, record)
    except MALFORMED as error:
        raise TrajectoryError(f"not a trajectory file: {type(error).__name__}: {error}") from error


def _usable(columns: tuple[str, ...], samples: Floats) -> Trajectory:
    try:
        return Trajectory(columns, samples)
    except ValueError as error:
        raise UnusableTrajectoryError(f"not a usable trajectory: {error}") from None


def check_columns(columns: tuple[str, ...]) -> None:
    """Refuse names that are no columns of a trajectory; raises ValueError."""
    if len(columns) < 2 or columns[0] != "t" or len(set(columns)) != len(columns):
        raise ValueError(f"columns must be distinct, 't' first and at least two: {columns}")


def _check_samples(samples: Floats, columns: tuple[str, ...]) -> None:
    if samples.ndim != 2 or samples.shape[1] != len(columns) or not len(samples):
        raise ValueError(f"samples have shape {samples.shape} for {len(columns)} columns")
    check_finite(samples, columns)
    if fault := disorder(samples):
        raise ValueError(fault)


def check_finite(samples: Floats, columns: tuple[str, ...]) -> None:
    """Refuse samples (T, n) of which a number is not finite; raises ValueError with its place and the remedy."""
    finite = np.isfinite(samples)
    if finite.all():
        return
    row = int(np.argmin(finite.all(axis=1)))
    column = int(np.argmin(finite[row]))
    at = f"t = {samples[row, 0]:g} s, " if column else ""
    raise ValueError(
        f"samples are not finite: {columns[column]} is {samples[row, column]} at {at}row {row}; fix the arithmetic "
        "there (a division by 0, an overflow, an unstable step), or keep the system out of this start"
    )


def _evidence_records(data: bytes) -> Evidence:
    """Return the metadata record and both attachments, which precede the chunks of the visual part."""
    # Not `validate_crcs`: every byte has been checked, and this reader would add up its checksum read by read.
    reader = StreamReader(io.BytesIO(data), emit_chunks=True, record_size_limit=len(data))
    first = itertools.takewhile(lambda record: not isinstance(record, ReadChunk | DataEnd), reader.records)
    records: list[McapRecord] = list(first)
    metadata = [record.metadata for record in records if isinstance(record, Metadata)]
    attachments = [record for record in records if isinstance(record, Attachment)]
    names = sorted(record.name for record in attachments)
    if len(metadata) != 1 or names != sorted((EVIDENCE, REQUEST)):
        raise TrajectoryError(
            f"{len(metadata)} metadata records and the attachments {names}, not one record and the two of perfbound"
        )
    return metadata[0], {record.name: record.data for record in attachments}


def _drawn(trajectory: Trajectory, visual: Visual, units: Mapping[str, str]) -> tuple[Sequence[bytes], Iterable[Chunk]]:
    """Return the types and channels of a visual part with a scene, and its chunks."""
    from .channels import channels  # noqa: PLC0415  (the types of foxglove, which few workers need)

    shown = {name: units[name] for name in trajectory.columns}
    kinds: dict[str, int] = {}
    definitions: list[bytes] = []
    messages: list[tuple[int, int, bytes]] = []
    for number, each in enumerate(channels(visual, trajectory.samples[trajectory.frames], shown), start=1):
        name = each.kind.full_name
        if name not in kinds:
            kinds[name] = len(kinds) + 1
            definitions.append(type_record(kinds[name], name, "protobuf", each.definition))
        definitions.append(channel_record(number, kinds[name], each.topic, "protobuf", each.metadata))
        messages += ((time, number, data) for time, data in each.messages)
    messages.sort(key=itemgetter(0, 1))
    return definitions, chunked(definitions, messages)


def _plotted(trajectory: Trajectory, units: Mapping[str, str]) -> tuple[Sequence[bytes], Chunk]:
    """Return the types and channels of a visual part with a channel for each column, and its one chunk."""
    names = plots.shown(trajectory.columns)
    definitions = _plot_channels(tuple((name, units[name]) for name in names))
    head = b"".join(definitions)
    found = plots.messages(trajectory.samples, len(head))
    return definitions, Chunk(head + found.records, found.first, found.last, dict(enumerate(found.indexes, start=1)))


@lru_cache(maxsize=64)
def _plot_channels(units: tuple[tuple[str, str], ...]) -> tuple[bytes, ...]:
    """Return the records of the message type and of the channels, for columns with their units."""
    kind = type_record(1, plots.MESSAGE, plots.SCHEMA_ENCODING, plots.DEFINITION)
    numbered = enumerate(units, start=1)
    return kind, *(channel_record(k, 1, f"/{name}", plots.ENCODING, {"unit": unit}) for k, (name, unit) in numbered)

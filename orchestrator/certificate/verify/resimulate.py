"""The re-simulation of random rollouts: a test on a sample that the trajectories come from the simulator."""

import math
import random
import secrets
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....schemas.base import canonical_json
from ....schemas.batch import BatchRequest
from ....schemas.ids import FileId
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.batch import Batch, read_batch
from ....schemas.trajectory.reduced import Reduced, read_stored, reduced_file
from ....schemas.trajectory.trajectory import Trajectory, read_mcap
from ....schemas.trajectory.visual import Floats
from ...campaign.decisions import scores_of_batch
from ...campaign.observation import Observer
from ...mathematics.bounds.one_law.share import unseen_share
from ...store import files
from .checks import CheckFailed
from .manifest import Entry

AT_A_TIME = 2
TOLERANCE = 1e-9
"""The largest difference that another type of machine may cause, in the unit of the column."""

Simulate = Callable[[Path, RolloutRequest | BatchRequest], None]
"""Writes the file of a rollout."""


@dataclass(frozen=True, slots=True)
class Repetition:
    """Where the recorded rollouts are, and how they are simulated and scored again."""

    directory: Path
    entries: Mapping[FileId, Entry]
    simulate: Simulate
    observer: Observer
    """Scores those whose samples were not kept: their scores are compared in place of them."""


@dataclass(frozen=True, slots=True)
class Resimulation:
    """One rollout or batch that was simulated again, compared with its recorded trajectory."""

    file: FileId
    bitwise: bool
    difference: float
    """The largest one of any number, in the unit of its column."""


def resimulate(wanted: Repetition, count: int, progress: Callable[[int], None]) -> tuple[Resimulation, ...]:
    """Simulate `count` rollouts or batches again, chosen at random after the evidence is fixed.

    Raises:
        CheckFailed: one gives another trajectory.
        PerfboundError: the system cannot be simulated here.

    """
    # From the operating system, after the evidence is fixed: a forger cannot prepare the rollouts that are chosen.
    chooser = random.Random(secrets.randbits(64))  # noqa: S311  (seeded by the operating system)
    chosen = chooser.sample(sorted(wanted.entries), min(count, len(wanted.entries)))
    found: list[Resimulation] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(AT_A_TIME) as pool:
        for again in pool.map(lambda file: _simulate_again(wanted, file, Path(folder)), chosen):
            found.append(again)
            progress(len(found))
    return tuple(found)


def _simulate_again(wanted: Repetition, file: FileId, folder: Path) -> Resimulation:
    entry = wanted.entries[file]
    before = files.read_evidence(wanted.directory, entry.path, entry.sha256)
    recorded = read_stored(before) if file.places else None
    request: RolloutRequest | BatchRequest
    if recorded is None:
        request = RolloutRequest.model_validate_json(canonical_json(read_mcap(before).request))
    else:
        request = BatchRequest.model_validate_json(recorded.request)
    out = folder / f"{file}.mcap"
    wanted.simulate(out, request)
    after = out.read_bytes()
    out.unlink()
    if recorded is not None and isinstance(recorded.batch, Reduced):
        after = _as_kept(recorded.batch, after, wanted.observer)
    if after == before:
        return Resimulation(file, bitwise=True, difference=0.0)
    if recorded is None:
        distance, bitwise = _difference(before, after), False
    else:
        again = read_stored(after).batch
        distance, bitwise = _batch_difference(recorded.batch, again), _same_digests(recorded.batch, again)
    # In this form a NaN, of which every comparison is false, fails.
    if not distance <= TOLERANCE:
        raise CheckFailed("resimulation", f"{file}: simulated again, it differs by up to {distance:.3g}")
    return Resimulation(file, bitwise=bitwise, difference=distance)


def _as_kept(before: Reduced, after: bytes, observer: Observer) -> bytes:
    """Return the file of a batch that was simulated again, reduced as the recorded one."""
    batch, request, _ = read_batch(after)
    # Every rollout is scored: a robustness that no samples back any more could be any number.
    found = scores_of_batch(observer, BatchRequest.model_validate_json(request), batch)
    kept = [place for place in before.kept if place not in found.failures]
    return reduced_file(after, kept, found)


def _batch_difference(a: Batch | Reduced, b: Batch | Reduced) -> float:
    """Return the largest difference of any number; a rollout that failed in one of the two is left out.

    Of one whose samples were not kept the scores are compared in place of them.
    """
    if a.columns != b.columns or a.time.shape != b.time.shape or len(a) != len(b):
        return math.inf
    both = sorted({*a.succeeded} & {*b.succeeded})
    distances = [np.abs(a.time - b.time)]
    if isinstance(a, Reduced) and isinstance(b, Reduced):
        first, second = a.scores.rows[:, both], b.scores.rows[:, both]
        # NaN: it did not end early. A mark, or an end, that only one of them has is no last digit.
        distances.append(np.where(np.isnan(first) & np.isnan(second), 0.0, np.abs(first - second)))
        both = sorted({*a.kept} & {*b.kept})
    distances.append(np.abs(_samples(a, both) - _samples(b, both)))
    return float(max(np.max(each, initial=0.0) for each in distances))


def _same_digests(a: Batch | Reduced, b: Batch | Reduced) -> bool:
    """Whether the rollouts that succeeded in both batches agree in every bit."""
    return all(one == other for one, other in zip(a.digests, b.digests, strict=True) if one and other)


def _samples(batch: Batch | Reduced, places: Sequence[int]) -> Floats:
    """Return the samples of some of the rollouts, column x rollout x time."""
    return batch.values[:, [batch.kept.index(each) for each in places] if isinstance(batch, Reduced) else list(places)]


def _difference(before: bytes, after: bytes) -> float:
    return _sample_difference(read_mcap(before).trajectory, read_mcap(after).trajectory)


def _sample_difference(a: Trajectory, b: Trajectory) -> float:
    if a.columns != b.columns or a.samples.shape != b.samples.shape:
        return float("inf")
    return float(np.max(np.abs(a.samples - b.samples)))


def finding(again: tuple[Resimulation, ...], total: int) -> str:
    """Return the finding for `workers_honest`, as a sentence; `total` are the files of the evidence."""
    count = len(again)
    # A batch is drawn and simulated as a whole: so many of its rollouts would not be a sample of so many.
    what = "files" if any(each.file.places for each in again) else "rollouts"
    same = sum(each.bitwise for each in again)
    how = "bitwise the same" if same == count else f"{same:,} bitwise the same, the others within {TOLERANCE:g}"
    if count == total:
        return f"all {total:,} {what}, {how}: workers_honest is checked"
    percent = math.ceil(1000 * unseen_share(count, 0.05)) / 10
    return (
        f"{count:,} of {total:,} {what}, {how}: workers_honest is sampled; if more than {percent:g} % were false, "
        "this check would fail with probability at least 0.95"
    )

"""The re-simulation of random rollouts: a test on a sample that the trajectories come from the simulator."""

import math
import random
import secrets
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....schemas.base import canonical_json
from ....schemas.batch import BatchRequest
from ....schemas.ids import FileId
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.batch import read_batch
from ....schemas.trajectory.trajectory import Trajectory, read_mcap
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
class Resimulation:
    """One rollout or batch that was simulated again, compared with its recorded trajectory."""

    file: FileId
    bitwise: bool
    difference: float
    """The largest one of any number, in the unit of its column."""


def resimulate(
    directory: Path,
    entries: Mapping[FileId, Entry],
    count: int,
    progress: Callable[[int], None],
    simulate: Simulate,
) -> tuple[Resimulation, ...]:
    """Simulate `count` rollouts or batches again by `simulate`, chosen at random after the evidence is fixed.

    Raises:
        CheckFailed: one gives another trajectory.
        PerfboundError: the system cannot be simulated here.

    """
    # From the operating system, after the evidence is fixed: a forger cannot prepare the rollouts that are chosen.
    chooser = random.Random(secrets.randbits(64))  # noqa: S311  (seeded by the operating system)
    chosen = chooser.sample(sorted(entries), min(count, len(entries)))
    found: list[Resimulation] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(AT_A_TIME) as pool:
        tasks = ((directory, file, entries[file], Path(folder), simulate) for file in chosen)
        for again in pool.map(lambda task: _simulate_again(*task), tasks):
            found.append(again)
            progress(len(found))
    return tuple(found)


def _simulate_again(directory: Path, file: FileId, entry: Entry, folder: Path, simulate: Simulate) -> Resimulation:
    before = files.read_evidence(directory, entry.path, entry.sha256)
    out = folder / f"{file}.mcap"
    if file.places:
        simulate(out, BatchRequest.model_validate_json(read_batch(before).request))
    else:
        simulate(out, RolloutRequest.model_validate_json(canonical_json(read_mcap(before).request)))
    after = out.read_bytes()
    out.unlink()
    if after == before:
        return Resimulation(file, bitwise=True, difference=0.0)
    distance = _batch_difference(before, after) if file.places else _difference(before, after)
    # In this form a NaN, of which every comparison is false, fails.
    if not distance <= TOLERANCE:
        raise CheckFailed("resimulation", f"{file}: simulated again, it differs by up to {distance:.3g}")
    return Resimulation(file, bitwise=distance == 0.0 and file.places > 0, difference=distance)


def _batch_difference(before: bytes, after: bytes) -> float:
    """Return the largest difference of any number; a rollout that failed in one of the two is left out."""
    a, b = read_batch(before).batch, read_batch(after).batch
    if a.columns != b.columns or a.values.shape != b.values.shape:
        return float("inf")
    both = sorted({*a.succeeded} & {*b.succeeded})
    return float(max(np.max(np.abs(a.time - b.time)), np.max(np.abs(a.values[:, both] - b.values[:, both]), initial=0)))


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
        "this check would fail with probability at least .95"
    )

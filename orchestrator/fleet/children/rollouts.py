"""Rollouts that no campaign records, before or as it begins: in one child process, one after the other."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....schemas.batch import BatchRequest, alone
from ....schemas.errors import CampaignError, PerfboundError, TrajectoryError
from ....schemas.ids import RolloutId
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import SystemSpec
from ....schemas.trajectory.trajectory import Trajectory, decode
from .child import CHILD_TIMEOUT, HangError, ask, system_options, system_spec

Done = Callable[[int], None]
"""Progress callback: rollouts that are finished."""
TRIED = 64
"""Rollouts of a trial batch."""
FASTEST = 1e-4
"""Seconds that a trial batch takes at least: the clock of files shows no less."""


class ChildRolloutError(PerfboundError):
    """A rollout gave no trajectory; the text names its start."""


class SlowRolloutError(ChildRolloutError):
    """A rollout has not ended in its time."""


def simulated_spec(reference: str, where: str, horizon: float | None = None) -> SystemSpec:
    """Return a system of which rollouts can be made here; raises as `system_spec`, and of a rig."""
    spec = system_spec(reference, where, horizon)
    if spec.repeated == "nowhere":
        raise CampaignError(
            f"{where}: {spec.name} is a rig, of which nothing here makes a rollout; its campaign file is written by "
            "hand, and `perfbound import` or `perfbound orchestrate` runs it"
        )
    return spec


@dataclass(frozen=True, slots=True)
class ChildSystem:
    """A system, and what its rollouts may take."""

    reference: str
    """A name, FILE.py:NAME or a campaign file."""
    spec: SystemSpec
    limit: float
    """Seconds of a rollout."""
    seconds: float
    """No rollout starts later than this after the first one."""


def simulate_in_child(
    system: ChildSystem, requests: Sequence[RolloutRequest | BatchRequest], folder: Path, done: Done = lambda _: None
) -> None:
    """Write the file of each rollout or batch into an empty folder, as far as they come in their time.

    Raises:
        ChildRolloutError: a rollout fails, or does not end.

    """
    listed = folder / "requests"
    listed.write_text("".join(request.model_dump_json() + "\n" for request in requests))
    place = ("--requests", str(listed), "--out", str(folder), "--seconds", str(system.seconds))
    try:
        # A file for each rollout, and before them one that says that the system is loaded.
        steps = partial(_written, folder, done)
        loading = max(system.limit, CHILD_TIMEOUT)  # it may take longer than a rollout
        options = system_options(system.reference)
        ask("pilot", *place, *options, limit=system.limit, loading=loading, steps=steps)
    except PerfboundError as error:
        missing = (each for number, each in enumerate(requests) if not file_of(folder, number).exists())
        failed = next(missing, requests[-1])
        hang = f"the rollout gave no result within {system.limit:g} s, and was ended"
        reason = f"{hang}{error.place}" if isinstance(error, HangError) else error
        kind = SlowRolloutError if isinstance(error, HangError) else ChildRolloutError
        raise kind(f"{alone(failed).words(system.spec)}: {reason}") from None


def finished(
    system: ChildSystem, requests: Sequence[RolloutRequest], folder: Path
) -> Iterator[tuple[RolloutRequest, Trajectory, float]]:
    """Yield the rollouts that are in a folder, and when they were written; one at a time, since they may be large.

    Raises:
        ChildRolloutError: a file is no trajectory.

    """
    for number, request in enumerate(requests):
        path = file_of(folder, number)
        if not path.exists():
            return
        try:
            trajectory = decode(path.read_bytes())
        except TrajectoryError as fault:
            raise ChildRolloutError(f"{request.words(system.spec)}: {fault}") from None
        yield request, trajectory, path.stat().st_mtime


def trial_batches(template: RequestTemplate, requests: Sequence[RolloutRequest]) -> list[BatchRequest]:
    """Return two equal batches of rollouts like these, whose second one shows what a rollout costs in a batch.

    There are none for a system that simulates one after the other, whose rollouts cost the same in a batch.
    """
    if not template.spec.vectorised:
        return []
    first = requests[0]
    alike = [each for each in requests if each.variant == first.variant]
    chosen = [alike[number % len(alike)] for number in range(TRIED)]
    seeds = [each.seed ^ (number // len(alike)) for number, each in enumerate(chosen)]
    place = RolloutId(first.problem, 0, first.variant, 0)
    batch = template.batch(place, [each.x for each in chosen], seeds)
    return [batch, batch]  # the first one compiles


class BatchCost(NamedTuple):
    """The cost of one more rollout of a batch."""

    seconds: float
    size: float
    """Bytes."""


def cost_in_batch(folder: Path, rollouts: int) -> BatchCost | None:
    """Return the cost in the `trial_batches` behind so many rollouts; None if none ran."""
    if not file_of(folder, rollouts + 1).exists():
        return None
    path, written = file_of(folder, rollouts + 1), [file_of(folder, k).stat().st_mtime for k in range(rollouts + 2)]
    *singly, _, batched = [after - before for before, after in pairwise(written)]
    # A batch may take as long as one rollout: what counts is what each further one adds.
    seconds = max(batched - min(singly, default=0.0), FASTEST) / (TRIED - 1)
    return BatchCost(seconds, path.stat().st_size / TRIED)


def have_one_grid(trajectories: Sequence[Trajectory]) -> bool:
    """Whether rollouts have the same sample times, without which they cannot be one batch."""
    times = [each.samples[:, 0] for each in trajectories]
    return all(np.array_equal(each, times[0]) for each in times)


def peak_memory(folder: Path) -> int:
    """Return the bytes of memory that the child had at most, after its rollouts."""
    return 1024 * int(_loaded(folder)["memory"])


def file_size(folder: Path) -> float:
    """Return the bytes of the file of the first rollout."""
    return file_of(folder, 0).stat().st_size


def undeclared_files(folder: Path) -> tuple[str, ...]:
    """Return the files that the rollouts of the child have read and that are no part of the system."""
    return tuple(map(str, _loaded(folder)["opened"]))


def _loaded(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "loaded").read_text())
    return found


def file_of(folder: Path, number: int) -> Path:
    """Return where `simulate_in_child` writes the file of a request, by its number from 0."""
    return folder / f"{number}.mcap"


def _written(folder: Path, done: Done) -> int:
    files = sum(1 for _ in folder.iterdir())
    done(max(0, files - 2))  # the list of requests, and the file of a loaded system
    return files

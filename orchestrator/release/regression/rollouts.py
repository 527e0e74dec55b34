"""The rollouts of a regression export, in a child process."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from ....schemas.errors import UnusableTrajectoryError
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.trajectory import Trajectory
from ...campaign.admission import check_whole
from ...fleet.children.rollouts import ChildRolloutError, ChildSystem, finished, simulate_in_child
from .outcome import Judge, Outcome


def simulated(system: ChildSystem, judge: Judge, requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
    """Return what rollouts show, from one child process; None of one that gives no trajectory, as where it crashes."""
    found = list[Outcome | None]()
    while len(found) < len(requests):
        left = requests[len(found) :]
        with tempfile.TemporaryDirectory() as folder:
            try:
                simulate_in_child(system, left, Path(folder))
                found += _outcomes(system, left, Path(folder), judge)
            except ChildRolloutError:
                found += [*_outcomes(system, left, Path(folder), judge), None]
    return found[: len(requests)]


def _outcomes(
    system: ChildSystem, requests: Sequence[RolloutRequest], folder: Path, judge: Judge
) -> Iterator[Outcome | None]:
    for request, trajectory, _ in finished(system, requests, folder):
        yield _outcome(trajectory, request, system, judge)


def _outcome(trajectory: Trajectory, request: RolloutRequest, system: ChildSystem, judge: Judge) -> Outcome | None:
    try:
        check_whole(trajectory, tuple(column.name for column in system.spec.columns), request.horizon)
        return judge.outcome(trajectory)
    except (UnusableTrajectoryError, ValueError):
        return None

"""The checks of a result against its request: bytes, columns, times; `border` adds those of the objective."""

import hashlib

from ...schemas.base import canonical_json
from ...schemas.errors import EvidenceError, RequestError, TrajectoryError, UnusableTrajectoryError
from ...schemas.instants import uncovered
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.trajectory import Trajectory, read_canonical


def admit(request: RolloutRequest, columns: tuple[str, ...], payload: bytes, sha256: str) -> Trajectory:
    """Return the trajectory of the rollout that `request` describes, from the bytes of its file.

    `columns` are those of the system, `sha256` is the digest that the sender announces or the manifest lists.

    Raises:
        RequestError: the file answers another request.
        UnusableTrajectoryError: the trajectory is not finite, has other columns, or does not cover 0 to the horizon.
        EvidenceError: the bytes have another digest, or are no trajectory file.

    """
    # Before everything else: a decoder reads no bytes that were damaged on their way.
    if hashlib.sha256(payload).hexdigest() != sha256:
        raise EvidenceError("the result does not have the sha256 that its sender announces")
    try:
        file = read_canonical(payload, visual=request.visual)
    except UnusableTrajectoryError:
        raise
    except TrajectoryError as fault:
        raise EvidenceError(f"the result is not a trajectory: {fault}") from None
    wanted = request.model_dump(mode="json")
    if canonical_json(file.request) != canonical_json(wanted):  # as text: 1, 1.0 and true are equal in Python
        differing = sorted(key for key in file.request | wanted if file.request.get(key) != wanted.get(key))
        raise RequestError(f"the trajectory was simulated for another request (other {', '.join(differing)[:200]})")
    check_whole(file.trajectory, columns, request.horizon)
    # The metadata name campaign, rollout and seed again; the columns in it were compared with the system's above.
    if {**file.metadata, "columns": ""} != {**request.metadata, "columns": ""}:
        raise RequestError("the metadata of the trajectory are those of another rollout")
    return file.trajectory


def check_whole(trajectory: Trajectory, columns: tuple[str, ...], horizon: float) -> None:
    """Refuse a trajectory that does not have these columns, or does not cover 0 to the horizon in s.

    Raises:
        UnusableTrajectoryError: with what is wrong.

    """
    if trajectory.columns != columns:
        raise UnusableTrajectoryError(f"the trajectory has the columns {', '.join(trajectory.columns)[:200]}")
    t = trajectory.samples[:, 0]
    if fault := uncovered(t, horizon):
        raise UnusableTrajectoryError(fault)

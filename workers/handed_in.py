"""A trajectory that was made elsewhere, as the file that a worker writes of a rollout."""

from collections.abc import Sequence
from typing import Any

from ..schemas.rollout import RolloutRequest
from ..schemas.system import SystemSpec
from ..schemas.trajectory.trajectory import Trajectory
from .simulate import run_request_on
from .systems.described import DescribedSystem


class _Told(DescribedSystem):
    """A system whose next rollout is known."""

    def __init__(self, spec: SystemSpec, trajectory: Trajectory) -> None:
        super().__init__(spec)
        self._trajectory = trajectory

    def rollout(self, x: Sequence[float], **arguments: Any) -> Trajectory:  # noqa: ARG002  (it is known)
        return self._trajectory


def file_of(trajectory: Trajectory, request: RolloutRequest, spec: SystemSpec) -> bytes:
    """Return the file of a trajectory that answers a request.

    Raises:
        SimulationError: its columns are not those of the system.

    """
    return run_request_on(_Told(spec, trajectory), request, lambda _: None)

"""A trajectory that was made elsewhere, as the file that a worker writes of a rollout."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..schemas.errors import EvidenceError, UnusableTrajectoryError
from ..schemas.file.logs import driven_column
from ..schemas.real_numbers import real_number
from ..schemas.rollout import RolloutRequest
from ..schemas.system import SystemSpec
from ..schemas.trajectory.trajectory import Trajectory
from .simulate import run_request_on
from .systems.described import DescribedSystem

Floats = NDArray[np.float64]


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


def whole(found: Mapping[str, Floats], spec: SystemSpec, constants: Mapping[str, float]) -> Trajectory:
    """Return the trajectory of columns (T,) and of those that are one number.

    Raises:
        UnusableTrajectoryError: its numbers are not finite, or its time does not increase.

    """
    count = len(next(iter(found.values())))
    columns = {**found, **{name: np.full(count, value) for name, value in constants.items()}}
    try:
        return Trajectory(spec.own_columns, np.column_stack([columns[name] for name in spec.own_columns]))
    except ValueError as fault:
        raise UnusableTrajectoryError(str(fault)) from None


def constants_of(
    spec: SystemSpec,
    x: Sequence[float],
    start: Mapping[str, object] | None = None,
    disturbances: Mapping[str, object] | None = None,
) -> dict[str, float]:
    """Return the columns that are one number of a whole rollout: the start that was driven, and disturbances.

    Without `start` it was the one that was asked for, `x` (p,). Disturbances that are not given are in the log itself.

    Raises:
        EvidenceError: a name is none of the rig, or a value is no finite number.

    """
    columns = {each.name for each in spec.columns}
    asked = {each.name: value for each, value in zip(spec.parameters, x, strict=True)}
    known = [name for name in asked if driven_column(name) in columns]
    if start and not known:
        raise EvidenceError("start: the rig has no tolerance, so a start is the one that was asked for; give it one")
    driven = asked | _numbers("start", start or {}, known)
    laws = [each.name for each in spec.reported]
    return {driven_column(name): driven[name] for name in known} | _numbers("disturbances", disturbances or {}, laws)


def _numbers(key: str, given: Mapping[str, object], known: Iterable[str]) -> dict[str, float]:
    names, found = list(known), dict[str, float]()
    if not isinstance(given, Mapping):
        raise EvidenceError(f"{key}: {type(given).__name__} is no dict; give {{name: number}}")
    for name, value in given.items():
        if name not in names:
            raise EvidenceError(f"{key}: {name!r} is none of {', '.join(names) or 'the rig, which declares none'}")
        try:
            found[str(name)] = real_number(value)
        except ValueError as fault:
            raise EvidenceError(f"{key}: {name} {fault}") from None
    return found

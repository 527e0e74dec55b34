"""One rollout on this worker: from the request to the bytes of the trajectory's file."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from ..schemas.base import canonical_json
from ..schemas.batch import BatchRequest
from ..schemas.errors import SimulationError
from ..schemas.rollout import RolloutRequest, WithinBatch
from ..schemas.trajectory.early_end import held, with_end
from ..schemas.trajectory.input_signal import InputSignal, start_values, with_signals
from ..schemas.trajectory.trajectory import File, Trajectory, encode
from .systems import load_system
from .systems.base import Progress, SystemUnderTest, Vectorised, disturbances_of
from .systems.pair import TwoSimulators


def run_request(request: RolloutRequest, progress: Progress) -> bytes:
    """Simulate a rollout with the installed system that the request names.

    Raises:
        UnknownSystemError: the system is not installed.
        SimulationError: the system is another one than the request expects, or has no usable trajectory.
        Cancelled: raised by `progress`.

    """
    return run_request_on(requested_system(request), request, progress)


def requested_system(request: RolloutRequest | BatchRequest) -> SystemUnderTest:
    """Return the installed system that a request names; of two simulators that of its variant.

    Raises:
        UnknownSystemError: the system is not installed.
        SimulationError: it is another build than the request expects.

    """
    system = load_system(request.system)
    if isinstance(system, TwoSimulators):
        system = system.half(request.variant)
    spec = system.spec
    if request.spec_sha256 != spec.digest:
        installed = ", ".join([*(f"{name} {version}" for name, version in spec.versions.items()), *spec.code])
        raise SimulationError(f"the campaign expects another build of {spec.name} than this one ({installed})")
    return system


def run_request_on(system: SystemUnderTest, request: RolloutRequest, progress: Progress) -> bytes:
    """Simulate a rollout on `system`; every exception but `Cancelled` is a failure of the system.

    Raises:
        SimulationError: the system has no usable trajectory.
        Cancelled: raised by `progress`.

    """
    return _file(system, request, simulated(system, request, progress))


def drawn(file: File) -> bytes:
    """Return the file of a rollout with the visual part that its system draws from the trajectory.

    Raises:
        UnknownSystemError: the system is not installed.
        SimulationError: it is another build than the request expects.

    """
    request = RolloutRequest.model_validate_json(canonical_json({**file.request, "visual": True}))
    system, trajectory = requested_system(request), file.trajectory
    spec = system.spec
    # As in `simulated`: the system draws its own columns.
    own = Trajectory(spec.own_columns, trajectory.samples[:, : len(spec.own_columns)])
    visual = system.visual(own)
    return _file(system, request, trajectory if visual is None else trajectory.showing(visual))


def _file(system: SystemUnderTest, request: RolloutRequest, trajectory: Trajectory) -> bytes:
    units = {column.name: column.unit for column in system.spec.spread(request.signals).columns}
    return encode(trajectory, request=request.model_dump(mode="json"), metadata=request.metadata, units=units)


def simulated(system: SystemUnderTest, request: RolloutRequest, progress: Progress) -> Trajectory:
    """Return the trajectory of a rollout, with its visual part if the request asks for it; raises as the file."""
    spec = system.spec
    known, start = spec.spread(request.signals), dict[str, float | InputSignal]()
    common: dict[str, Any] = {
        "variant": request.variant,
        "horizon": request.horizon,
        "options": request.options,
        "progress": progress,
    }
    if request.within is not None:
        trajectory = _of_batch(system, request.within, common)
    else:
        start = start_values(known, request.x, request.horizon)
        drawn = disturbances_of(spec, request.disturbances)
        trajectory = system.rollout(tuple(start.values()), seed=request.seed, **common, **drawn)
    if trajectory.columns != spec.own_columns:
        raise SimulationError(f"{spec.name} returned the columns {trajectory.columns}, not those of its spec")
    samples = len(trajectory.samples)
    if spec.after_end is not None:
        trajectory = held(trajectory, request.horizon)
    visual = system.visual(trajectory) if request.visual else None
    trajectory = with_signals(trajectory, known, start)
    if spec.after_end is not None:
        trajectory = with_end(trajectory, samples)
    return trajectory if visual is None else trajectory.showing(visual)


def _of_batch(system: SystemUnderTest, within: WithinBatch, common: Mapping[str, Any]) -> Trajectory:
    """Return the trajectory of one rollout of a batch that is simulated as a whole."""
    if not system.spec.vectorised:
        raise SimulationError(f"{system.spec.name} is not vectorised, and repeats no batch")
    starts = np.repeat(np.array(within.x), len(within.seeds) // len(within.x), axis=0)
    seeds = np.array(within.seeds, dtype=np.uint64)
    drawn = disturbances_of(system.spec, np.array(within.disturbances).T)
    found = np.asarray(cast(Vectorised, system).rollouts(starts, seeds=seeds, **common, **drawn))
    try:
        return Trajectory(system.spec.own_columns, found[within.place])
    except ValueError as error:
        raise SimulationError(str(error)) from None

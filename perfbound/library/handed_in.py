"""What is handed in as the trajectory of a rollout, in any form, as the file that a worker would have written."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..orchestrator.run.told import Admitted
from ..orchestrator.store import files as evidence
from ..schemas.errors import EvidenceError, SimulationError, UnusableTrajectoryError, shortened
from ..schemas.file.logs import LogMapping
from ..schemas.ranges import MAX_FILE_BYTES
from ..schemas.real_numbers import real_number
from ..schemas.rollout import RolloutRequest
from ..schemas.system import SystemSpec
from ..schemas.trajectory.trajectory import Trajectory
from ..workers.handed_in import constants_of, file_of, whole
from ..workers.logs.read import LogReader
from ..workers.systems.function import as_samples, as_trajectory


def admitted(
    request: RolloutRequest,
    spec: SystemSpec,
    data: object,
    step: float | None,
    mapping: LogMapping | None,
    *,
    start: Mapping[str, object] | None = None,
    disturbances: Mapping[str, object] | None = None,
) -> Admitted:
    """Return what was told for a request; `step` is the time between two samples of data without `t`.

    A path is that of a log, which `mapping` explains, or of the MCAP file that `perfbound` has made for this request.

    Raises:
        UnusableTrajectoryError: the trajectory is not finite, or does not cover 0 to the horizon.
        EvidenceError: the data do not fit the system or the request, or a file cannot be read.

    """
    try:
        step = None if step is None else _seconds(step)
        constants = constants_of(spec, request.x, start, disturbances)
        if isinstance(data, str | Path) and Path(data).suffix.lower() == ".mcap" and mapping is None:
            payload = evidence.contents(Path(data), MAX_FILE_BYTES)
        elif isinstance(data, str | Path):
            reader = LogReader(spec, mapping, step)
            found = reader.trajectory(Path(data), request.horizon, constants=constants)
            payload = file_of(found, request, spec)
        else:
            payload = file_of(_trajectory(data, spec, step, constants), request, spec)
        return Admitted.of(payload, request, spec)
    except UnusableTrajectoryError as fault:
        raise UnusableTrajectoryError(
            f"{request.rollout}: {fault}; the request stays open; if the trial itself failed, record that: "
            "study.failed(request, REASON)"
        ) from None
    except (EvidenceError, SimulationError) as fault:
        raise EvidenceError(f"{request.rollout}: {fault}; the request stays open") from None


def _seconds(step: object) -> float:
    try:
        seconds = real_number(step)
    except ValueError as fault:
        raise EvidenceError(f"step {fault}, the seconds between two samples") from None
    if seconds <= 0:
        raise EvidenceError(f"step is {seconds:g}; give the seconds between two samples, above 0")
    return seconds


def _trajectory(data: object, spec: SystemSpec, step: float | None, constants: Mapping[str, float]) -> Trajectory:
    """Return what was told as a trajectory; `constants` are columns that are one number of the whole rollout.

    Raises:
        UnusableTrajectoryError: its numbers are not finite, or its time does not increase.
        EvidenceError: the columns of a table cannot be read.
        SimulationError: it has other columns, or they differ in length.

    """
    columns = tuple(name for name in spec.own_columns if name not in constants)
    if isinstance(data, Trajectory):
        if not constants or data.columns != columns:
            return replace(data, visual=None)
        data = {name: data.column(name) for name in columns}
    if not isinstance(data, Mapping) and hasattr(data, "columns") and hasattr(data, "__getitem__"):
        data = _columns_of_frame(data)
    samples = as_samples(data, columns, step)
    return whole({name: samples[:, k] for k, name in enumerate(columns)}, spec, constants)


def _columns_of_frame(data: Any) -> dict[str, object]:
    """Return the columns of a DataFrame, or of what has its methods."""
    try:
        return {str(name): data[name] for name in data.columns}
    except Exception as fault:  # noqa: BLE001  (of a library that is not known)
        reason = shortened(f"{type(fault).__name__}: {fault}")
        raise EvidenceError(f"{type(data).__name__}: its columns cannot be read ({reason}); give a dict") from None


def of_columns(given: Trajectory | Mapping[str, Any]) -> Trajectory:
    """Return a trajectory that may be given by its columns, (T,) each; without `t` it is one sample.

    Raises:
        SimulationError: the columns are none.

    """
    if isinstance(given, Trajectory):
        return given
    return as_trajectory(given, ("t", *(name for name in given if name != "t")), None)

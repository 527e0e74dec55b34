"""What is handed in as the trajectory of a rollout, in any form, as the file that a worker would have written."""

import csv
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..orchestrator.campaign.admission import admit
from ..orchestrator.store import files as evidence
from ..schemas.errors import EvidenceError, SimulationError, UnusableTrajectoryError, shortened
from ..schemas.number_text import number_in
from ..schemas.ranges import MAX_FILE_BYTES
from ..schemas.real_numbers import real_number
from ..schemas.rollout import RolloutRequest
from ..schemas.system import SystemSpec
from ..schemas.trajectory.trajectory import Trajectory, Visual
from ..workers.simulate import run_request_on
from ..workers.systems.base import SystemUnderTest
from ..workers.systems.function import Floats, as_samples

HEAD = re.compile(r"\s*([a-z][a-z0-9_]*)\s*(?:\((.*)\))?\s*")
"""A column's title in a CSV file: its name, and its unit in brackets."""


@dataclass(frozen=True)
class Admitted:
    """A trajectory that passed the checks of a worker's result, with its file."""

    payload: bytes
    sha256: str
    trajectory: Trajectory


def admitted(request: RolloutRequest, spec: SystemSpec, data: object, step: float | None) -> Admitted:
    """Return what was told for a request; `step` is the time between two samples of data without `t`.

    Raises:
        UnusableTrajectoryError: the trajectory is not finite, or does not cover 0 to the horizon.
        EvidenceError: the data do not fit the system or the request, or a file cannot be read.

    """
    columns = tuple(column.name for column in spec.columns)
    try:
        step = None if step is None else _seconds(step)
        if isinstance(data, str | Path) and Path(data).suffix.lower() == ".mcap":
            payload = evidence.contents(Path(data), MAX_FILE_BYTES)
        else:
            payload = run_request_on(_Told(spec, _trajectory(data, spec, step)), request, lambda _: None)
        sha256 = hashlib.sha256(payload).hexdigest()
        return Admitted(payload, sha256, admit(request, columns, payload, sha256))
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


class _Told(SystemUnderTest):
    """A system whose next rollout is known, so that its file is written as a worker writes it."""

    def __init__(self, spec: SystemSpec, trajectory: Trajectory) -> None:
        self._spec, self._trajectory = spec, trajectory

    @property
    def spec(self) -> SystemSpec:
        return self._spec

    def rollout(self, x: Sequence[float], **arguments: Any) -> Trajectory:  # noqa: ARG002  (it is known)
        return self._trajectory

    def visual(self, trajectory: Trajectory) -> Visual:  # noqa: ARG002  (the same for all)
        return Visual(plots=True)


def _trajectory(data: object, spec: SystemSpec, step: float | None) -> Trajectory:
    """Return what was told as a trajectory.

    Raises:
        UnusableTrajectoryError: its numbers are not finite, or its time does not increase.
        EvidenceError: a file cannot be read.
        SimulationError: it has other columns, or they differ in length.

    """
    if isinstance(data, Trajectory):
        return replace(data, visual=None)
    columns = spec.own_columns
    if isinstance(data, str | Path):
        units = {column.name: column.unit for column in spec.columns if column.name in columns}
        data = _columns_of_csv(Path(data), units)
    elif not isinstance(data, Mapping) and hasattr(data, "columns") and hasattr(data, "__getitem__"):
        data = _columns_of_frame(data)
    samples = as_samples(data, columns, step)
    try:
        return Trajectory(columns, samples)
    except ValueError as fault:
        raise UnusableTrajectoryError(str(fault)) from None


def _columns_of_frame(data: Any) -> dict[str, object]:
    """Return the columns of a DataFrame, or of what has its methods."""
    try:
        return {str(name): data[name] for name in data.columns}
    except Exception as fault:  # noqa: BLE001  (of a library that is not known)
        reason = shortened(f"{type(fault).__name__}: {fault}")
        raise EvidenceError(f"{type(data).__name__}: its columns cannot be read ({reason}); give a dict") from None


def _columns_of_csv(path: Path, units: Mapping[str, str]) -> dict[str, Floats]:
    """Return the columns of a CSV file; a title is a name, or a name and its unit in brackets."""
    try:
        text = evidence.contents(path, MAX_FILE_BYTES).decode("utf-8-sig")
        titles, *rows = [row for row in csv.reader(text.splitlines()) if row] or [[]]
    except UnicodeDecodeError:
        raise EvidenceError(f"{path}: not UTF-8; save it as UTF-8") from None
    except csv.Error as fault:  # a cell of megabytes
        raise EvidenceError(f"{path}: not CSV: {fault}; give {','.join(units)}") from None
    found = [HEAD.fullmatch(title) for title in titles]
    names = [each[1] for each in found if each]
    if sorted(names) != sorted(set(names)) or set(names) - {"t"} != set(units) - {"t"} or len(names) != len(titles):
        raise EvidenceError(f"{path}: its first line is {','.join(titles)[:80]!r}; give {','.join(units)}")
    for each in found:
        if each and each[2] is not None and each[2] != units[each[1]]:
            raise EvidenceError(f"{path}: {each[1]} is in {each[2][:20]!r}; give it in {units[each[1]]!r}")
    try:
        lines = [[number_in(cell) for cell in row] for row in rows]
    except ValueError as fault:
        raise EvidenceError(f"{path}: {fault}; give one number for each column in every line") from None
    if not lines or set(map(len, lines)) != {len(names)}:
        raise EvidenceError(f"{path}: {len(rows)} lines of differing lengths; give {len(names)} numbers in each")
    numbers = np.array(lines, dtype=np.float64)
    return {name: numbers[:, k] for k, name in enumerate(names)}

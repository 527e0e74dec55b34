"""The desk between a campaign and a person: one request at a time, until its log is handed in.

What is handed in is in a folder before it counts: a worker that is started again finds it there.
"""

import itertools
import json
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...schemas.atomic import make_folder, write_whole
from ...schemas.errors import EvidenceError, PerfboundError, SimulationError
from ...schemas.file.logs import driven_column, driven_fault
from ...schemas.system import OptionValue
from ...schemas.trajectory.trajectory import Trajectory
from ..handed_in import constants_of
from ..logs.read import LogReader
from ..systems.base import Progress
from ..systems.described import DescribedSystem
from ..systems.rig import DescribedRig

LOOK = 0.2
"""Seconds between two looks whether the request was withdrawn."""
MOST_DONE = 1000
"""Tests that the page lists."""


@dataclass(frozen=True)
class WantedTest:
    """A test that is wanted."""

    key: str
    """Names its files: the same after a restart."""
    x: tuple[float, ...]
    horizon: float


@dataclass
class _Answer:
    """How a test ended: with a trajectory, or with the reason why it has none."""

    trajectory: Trajectory | None = None
    failure: str = ""


@dataclass
class _State:
    trial: WantedTest | None = None
    answer: _Answer | None = None
    done: list[dict[str, str]] = field(default_factory=list)


class Desk(DescribedSystem):
    """The rig of a campaign file, driven by a person; `folder` gets the logs.

    `rollout` is called by the worker's thread, the others by that of the page.
    """

    def __init__(self, rig: DescribedRig, folder: Path) -> None:
        super().__init__(rig.spec)
        self.folder, self._tolerance = folder, rig.tolerance
        self._reader = LogReader(rig.spec, rig.mapping, rig.step)
        self._changed, self._state = threading.Condition(), _State()

    def rollout(
        self,
        x: Any,
        *,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],  # noqa: ARG002  (a rig has none)
        progress: Progress,
        **_: object,
    ) -> Trajectory:
        """Return the trajectory of the log that is handed in for this request, whenever that is.

        Raises:
            SimulationError: the test failed, as the person says.
            Cancelled: raised by `progress`.

        """
        trial = WantedTest(f"{seed:014x}", tuple(x), horizon)
        if (before := self._handed_in_before(trial)) is not None:
            return before
        ticks = itertools.count(1)
        with self._changed:
            self._state.trial, self._state.answer = trial, None
        try:
            while True:
                progress(next(ticks))  # the desk lives, whatever the person does; the request may be withdrawn
                with self._changed:
                    self._changed.wait(LOOK)
                    answer = self._state.answer
                if answer is not None:
                    break
        finally:
            with self._changed:
                self._state.trial = self._state.answer = None
        if answer.trajectory is None:
            raise SimulationError(answer.failure)
        return answer.trajectory

    def hand_in(self, key: str, log: Path, start: Mapping[str, object], disturbances: Mapping[str, object]) -> None:
        """Take the log of the request `key`.

        Raises:
            EvidenceError: there is no such request any more, or the log is none; the request stays open.

        """
        trial = self._open(key)
        given = {"log": str(log.absolute()), "start": dict(start), "disturbances": dict(disturbances)}
        trajectory = self._read(trial, given)
        self._keep(trial, given)
        self._answer(trial, _Answer(trajectory), log.name)

    def fail(self, key: str, reason: str) -> None:
        """Record that the test of a request failed in the system.

        Raises:
            EvidenceError: there is no such request any more, or no reason.

        """
        trial = self._open(key)
        if not reason.strip():
            raise EvidenceError("say why the test failed: the reason is recorded")
        self._answer(trial, _Answer(failure=reason.strip()[:500]), "failed")

    @property
    def described(self) -> dict[str, Any]:
        """What the page shows."""
        with self._changed:
            trial, done = self._state.trial, self._state.done[::-1]
        columns = [{"name": each.name, "unit": each.unit} for each in self.spec.columns]
        driven = {driven_column(each.name) for each in self.spec.parameters}
        return {
            "system": self.spec.name,
            "columns": [each for each in columns if each["name"] not in driven],
            "disturbances": [{"name": each.name, "unit": each.unit} for each in self.spec.reported],
            "folder": str(self.folder.absolute()),
            "trial": None if trial is None else self._described(trial),
            "done": done,
        }

    def _described(self, trial: WantedTest) -> dict[str, Any]:
        parameters = zip(self.spec.parameters, trial.x, strict=True)
        return {
            "key": trial.key,
            "horizon": trial.horizon,
            "start": [
                {"name": each.name, "unit": each.unit, "value": value, "tolerance": self._tolerance.get(each.name)}
                for each, value in parameters
            ],
        }

    def _open(self, key: str) -> WantedTest:
        with self._changed:
            trial = self._state.trial
        if trial is None or trial.key != key:
            raise EvidenceError("this request was withdrawn, or has its log; load the page again")
        return trial

    def _answer(self, trial: WantedTest, answer: _Answer, what: str) -> None:
        with self._changed:
            if self._state.trial != trial or self._state.answer is not None:
                raise EvidenceError("this request was withdrawn, or has its log; load the page again")
            self._state.answer = answer
            self._state.done.append({"key": trial.key, "what": what, "at": time.strftime("%Y-%m-%d %H:%M:%S")})
            del self._state.done[:-MOST_DONE]
            self._changed.notify_all()

    def _read(self, trial: WantedTest, given: Mapping[str, Any]) -> Trajectory:
        constants = constants_of(self.spec, trial.x, given["start"], given["disturbances"])
        asked = {each.name: value for each, value in zip(self.spec.parameters, trial.x, strict=True)}
        driven = {name: constants[driven_column(name)] for name in self._tolerance}
        if (fault := driven_fault(asked, driven, self._tolerance)) is not None:
            raise EvidenceError(fault)
        return self._reader.trajectory(Path(given["log"]), trial.horizon, constants=constants)

    def _record(self, trial: WantedTest) -> Path:
        return self.folder / f"{trial.key}.json"

    def _keep(self, trial: WantedTest, given: Mapping[str, Any]) -> None:
        make_folder(self.folder)
        write_whole(self._record(trial), json.dumps(given, indent=1).encode())

    def _handed_in_before(self, trial: WantedTest) -> Trajectory | None:
        """Return what was handed in before this worker, or its orchestrator, was started again."""
        try:
            return self._read(trial, json.loads(self._record(trial).read_bytes()))
        except (PerfboundError, OSError, ValueError, KeyError, TypeError):
            return None  # nothing was, or a file was changed or removed meanwhile: it is asked for

"""The Segway in MuJoCo as a system under test."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

import numpy as np

from ....schemas.errors import SimulationError, UnknownSystemError
from ....schemas.system import Column, OptionValue, Parameter, SystemSpec, Variant
from ....schemas.trajectory.trajectory import Floats, Trajectory, Visual
from ..base import Progress, Seeds, SystemUnderTest, checked_disturbances, checked_options, checked_starts
from ..segway.bullet import CONTROL_RATE
from ..segway.controller import GAINS
from ..segway.system import DISTURBANCES, OPTIONS, UNITS
from ..segway.visual import visual

if TYPE_CHECKING:
    from .world import MujocoWorld


class MujocoSegway(SystemUnderTest):
    """The system `segway` in MuJoCo, which simulates many rollouts in one call."""

    files = ("../segway/bullet.py", "../segway/controller.py", "../segway/system.py")
    """Whose constants it has."""

    def __init__(self) -> None:
        self._made: MujocoWorld | None = None

    @cached_property
    def spec(self) -> SystemSpec:
        """Parameters, columns, options and disturbances are those of `segway`.

        Raises:
            UnknownSystemError: MuJoCo is not installed.

        """
        try:
            versions = {each: version(each) for each in ("mujoco", "numpy")}
        except PackageNotFoundError:
            raise UnknownSystemError("segway-mujoco: pip install 'perfbound[mujoco]'") from None
        return SystemSpec(
            name="segway-mujoco",
            doc="The Segway of `segway` in MuJoCo (240 Hz physics, 120 Hz control); many rollouts in one call",
            parameters=tuple(Parameter(name=name, unit="m", low=-20.0, high=25.0) for name in ("x", "y")),
            columns=tuple(Column(name=name, unit=unit) for name, unit in UNITS.items()),
            options=OPTIONS,
            disturbances=DISTURBANCES,
            residual=False,
            max_horizon=120.0,
            default_horizon=15.0,
            versions=versions,
            vectorised=True,
        )

    def rollout(
        self,
        x: Sequence[float],
        *,
        variant: Variant,
        seed: int,  # noqa: ARG002  (its disturbances are all that is random)
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """Simulate `horizon` seconds, rounded to control steps of 1/120 s, from the starting condition (x, y) in m.

        Raises:
            SimulationError: an argument is outside the spec, or the trajectory is not finite.
            Cancelled: raised by `progress`.

        """
        chosen = checked_options(self.spec, x, variant=variant, horizon=horizon, options=options)
        errors = checked_disturbances(self.spec, disturbances)
        start = np.array([*x, 0.0, 0.0]) + [errors[each.name] for each in DISTURBANCES]
        rows = self._world.rollout(start, round(CONTROL_RATE * horizon), GAINS[str(chosen["gains"])], progress)
        try:
            return Trajectory(tuple(UNITS), rows)
        except ValueError as error:
            raise SimulationError(f"the rollout from {start} did not stay finite: {error}") from error

    def rollouts(
        self,
        starts: Floats,
        *,
        variant: Variant,
        seeds: Seeds,  # noqa: ARG002  (as of one rollout)
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, Floats] | None = None,
    ) -> Floats:
        """Simulate from all `starts` (R, 2) in one call; raises as `rollout`."""
        chosen = checked_options(self.spec, starts[0].tolist(), variant=variant, horizon=horizon, options=options)
        checked_starts(self.spec, starts)
        errors = checked_disturbances(self.spec, disturbances)
        begun = np.column_stack([starts, np.zeros_like(starts)]) + np.column_stack(
            [np.broadcast_to(errors[each.name], len(starts)) for each in DISTURBANCES]
        )
        return self._world.rollouts(begun, round(CONTROL_RATE * horizon), GAINS[str(chosen["gains"])], progress)

    def visual(self, trajectory: Trajectory) -> Visual:
        """Return the ground, the goal and the moving Segway."""
        return visual(trajectory)

    @property
    def _world(self) -> "MujocoWorld":
        if self._made is None:
            from .world import MujocoWorld  # noqa: PLC0415  (the registry and the spec must not cost the simulator)

            self._made = MujocoWorld()
        return self._made

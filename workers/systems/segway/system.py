"""The Segway as a system under test."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib.metadata import version

from ....schemas.errors import SimulationError
from ....schemas.file.disturbance import Normal
from ....schemas.system import Column, Option, OptionValue, Parameter, SystemSpec, Variant
from ....schemas.trajectory.trajectory import Trajectory, Visual
from ..base import Progress, SystemUnderTest, checked_disturbances, checked_options
from .bullet import CONTROL_RATE, StartPose, World, providers
from .controller import GAINS
from .visual import visual

UNITS = {
    "t": "s",
    "x": "m",
    "y": "m",
    "heading": "rad",
    "vx": "m/s",
    "vy": "m/s",
    "phi": "rad",
    "phidot": "rad/s",
    "voltage_left": "V",
    "voltage_right": "V",
}
OPTIONS = (Option(name="gains", default="paper", choices=tuple(GAINS), doc="tuning of the controller"),)
DISTURBANCES = tuple(
    Normal(0.0, math.sqrt(0.05), unit=unit).named(f"{name}_error", unit)
    for name, unit in (("x", "m"), ("y", "m"), ("heading", "rad"), ("phi", "rad"))
)
"""What the variant `true` adds to the start; the variance is that of [ARA]."""


class SegwaySystem(SystemUnderTest):
    """A Segway that starts at (x, y) at rest, upright, with heading 0, and drives to the goal (2.5, 2.5).

    `nominal` starts exactly there, `true` with normal errors of x, y, heading and phi. A Segway has fallen at
    |phi| > 1 rad; its last state is held from then on.
    """

    def __init__(self) -> None:
        self._world: World | None = None

    @cached_property
    def spec(self) -> SystemSpec:
        """Parameters x, y in m; the columns are the state, then the voltages of the wheels.

        Raises:
            UnknownSystemError: PyBullet is not installed.

        """
        return SystemSpec(
            name="segway",
            doc="A Segway in PyBullet (240 Hz physics, 120 Hz control) that drives to (2.5, 2.5) m and must not tilt",
            parameters=tuple(Parameter(name=name, unit="m", low=-20.0, high=25.0) for name in ("x", "y")),
            columns=tuple(Column(name=name, unit=unit) for name, unit in UNITS.items()),
            options=OPTIONS,
            disturbances=DISTURBANCES,
            residual=False,
            max_horizon=120.0,
            default_horizon=15.0,
            versions={"numpy": version("numpy"), **providers()},
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
        start = StartPose(*(value + errors[each.name] for value, each in zip(StartPose(*x), DISTURBANCES, strict=True)))
        if self._world is None:
            self._world = World()
        steps, gains = round(CONTROL_RATE * horizon), GAINS[str(chosen["gains"])]
        try:
            # A NaN survives into the samples, an infinity stops the controller's arithmetic: neither is a score.
            return Trajectory(tuple(UNITS), self._world.rollout(start, steps, gains, progress))
        except (ValueError, OverflowError) as error:
            raise SimulationError(f"the rollout from {start} did not stay finite: {error}") from error

    def visual(self, trajectory: Trajectory) -> Visual:
        """Return the ground, the goal and the moving Segway."""
        return visual(trajectory)

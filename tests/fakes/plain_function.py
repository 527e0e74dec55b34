"""A plug-in: the paper's test function without noise and without a twin, a rollout of which is one sample."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from perfbound.schemas.system import Column, OptionValue, Parameter, SystemSpec, Variant
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.systems.base import Progress, SystemUnderTest, checked_options

ROOT = Path(__file__).parents[2]
NAME = "plain-function"
CAMPAIGN = """name = "plain-function"
seed = 1
composition = "single"
resolution = 13
max_tests = 200
visual = "none"
specification = "value <= 0.6"

[system]
name = "plain-function"

[space]
z1 = { low = 0.0, high = 5.0, unit = "1" }
z2 = { low = 0.0, high = 5.0, unit = "1" }

[[problems]]
name = "robustness"
method = "rigorous"
delta = 0.05
alpha = 0.05
rkhs_norm = 2.0
noise_scale = 0.0
# J = value - 0.6, so that the model is of the value itself.
prior_mean = -0.6
kernel = { nu = 10.0, length_scale = 1.0 }
window = 2
"""
"""No horizon and no clip: the least robustness is .6 - .5 = .1, at (pi/2, 0)."""


class PlainFunction(SystemUnderTest):
    """J(z) = sin(z1) cos(z2) / 2, its only variant."""

    @cached_property
    def spec(self) -> SystemSpec:
        """As the test function has it, without the variant `true`."""
        return SystemSpec(
            name=NAME,
            doc="J(z) = sin(z1) cos(z2) / 2",
            parameters=tuple(Parameter(name=name, unit="1", low=0.0, high=5.0) for name in ("z1", "z2")),
            columns=(Column(name="t", unit="s"), Column(name="value", unit="1")),
            variants=("nominal",),
            noisy=(),
            max_horizon=1.0,
        )

    def rollout(
        self,
        x: Sequence[float],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> Trajectory:
        """Evaluate the function at `x`: one sample at time 0.

        Raises:
            SimulationError: an argument is not finite or outside the spec.
            Cancelled: raised by `progress`.

        """
        checked_options(self.spec, x, variant=variant, horizon=horizon, options=options)
        progress(1)
        return Trajectory(("t", "value"), np.array([[0.0, math.sin(x[0]) * math.cos(x[1]) / 2]]))


def install(folder: Path) -> Path:
    """Make a folder which, on the path of a process that finds `tests`, is the installed plug-in."""
    about = folder / "plain_function-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: plain-function\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[perfbound.systems]\n{NAME} = {__name__}:PlainFunction\n")
    return folder

"""The paper's two-dimensional test function, as a system whose rollouts cost nothing."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from importlib.metadata import version

import numpy as np

from ...schemas.system import Column, Option, OptionValue, Parameter, SystemSpec, Variant
from ...schemas.trajectory.trajectory import Trajectory
from .base import Progress, SystemUnderTest, checked_options


class TestFunctionSystem(SystemUnderTest):
    """J(z) = sin(z1) cos(z2) / 2, alone (nominal) or with Gaussian noise (true): one value, from 0 to the horizon.

    >>> system = TestFunctionSystem()
    >>> start = (math.pi / 2, 0.0)
    >>> rollout = system.rollout(start, variant="nominal", seed=0, horizon=1.0, options={}, progress=lambda step: None)
    >>> rollout.samples.tolist()
    [[0.0, 0.5], [1.0, 0.5]]
    """

    __test__ = False  # the name is the paper's; pytest would collect it

    @cached_property
    def spec(self) -> SystemSpec:
        """Parameters z1, z2 without unit; the only column is `value`."""
        noise = Option(
            name="noise_sd", default=0.001, low=0.0, high=1.0, unit="1", doc="standard deviation of the variant true"
        )
        return SystemSpec(
            name="test-function",
            doc="J(z) = sin(z1) cos(z2) / 2",
            parameters=tuple(Parameter(name=name, unit="1", low=0.0, high=5.0) for name in ("z1", "z2")),
            columns=(Column(name="t", unit="s"), Column(name="value", unit="1")),
            options=(noise,),
            max_horizon=3600.0,
            default_horizon=0.0,
            versions={"numpy": version("numpy")},
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
        """Evaluate the function at `x`: one value from 0 to the horizon.

        Raises:
            SimulationError: an argument is not finite or outside the spec.
            Cancelled: raised by `progress`.

        """
        noise_sd = float(checked_options(self.spec, x, variant=variant, horizon=horizon, options=options)["noise_sd"])
        value = math.sin(x[0]) * math.cos(x[1]) / 2
        if variant == "true":
            value += noise_sd * np.random.default_rng(seed).standard_normal()
        progress(1)
        times = (0.0, horizon) if horizon else (0.0,)
        return Trajectory(("t", "value"), np.array([[time, value] for time in times]))

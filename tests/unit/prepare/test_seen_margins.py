"""How many rollouts of `calibrate` and `check-system` violate the specification, and which is the worst."""

from typing import Any

import numpy as np

from perfbound.orchestrator.prepare.seen_margins import SeenMargins
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Variant
from perfbound.schemas.trajectory.trajectory import Trajectory
from tests.facts import says
from tests.fakes.simulators import robustness, spec

PROBLEM = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.1, "kernel": {"length_scale": 0.7}}


def request(x: tuple[float, ...], seed: int, variant: Variant = "nominal") -> RolloutRequest:
    return RolloutRequest(
        campaign="c",
        problem="robustness",
        test=0,
        variant=variant,
        replicate=0,
        x=x,
        seed=seed,
        horizon=0.0,
        visual=False,
        system="any-function",
        config_sha256="0" * 64,
        spec_sha256="0" * 64,
    )


def margins(found: list[tuple[tuple[float, ...], int, float]], *, noisy: bool = True, **changes: Any) -> SeenMargins:
    seen = SeenMargins(robustness(PROBLEM, clip=[-1, 1], **changes), spec(noisy=noisy))
    for x, seed, value in found:
        seen.add(request(x, seed), Trajectory(("t", "value"), np.array([[0.0, value]])))
    return seen


def test_each_rollout_counts_once_and_the_worst_is_named() -> None:
    corner, middle = (0.0, 0.0), (0.5, 0.25)
    seen = margins([(corner, 1, 0.5), (middle, 2, -3.0), (middle, 3, -0.5), (middle, 2, -3.0)])
    assert says(seen.words, "^2 3 rollouts -3.0000 z1 = 0.5 z2 = 0.25 seed 2")
    found = seen.violations
    assert found is not None
    assert (found.starts, found.violating_starts) == (2, 1)
    assert says(
        margins([(corner, 1, -0.5), (middle, 1, 0.0)], noisy=False).words, "^1 2 rollouts -0.5000 z1 = 0 z2 = 0"
    )


def test_without_a_rollout_or_a_specification_there_are_no_words() -> None:
    column = {**PROBLEM, "name": "maximum", "column": "value"}
    assert margins([]).words == ""
    assert margins([((0.0, 0.0), 1, -1.0)], problems=[column], specification=None).words == ""

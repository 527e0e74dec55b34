"""The sample that a picture of a rollout marks: the one with the least margin."""

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.report.rollout.replay import margins
from perfbound.schemas.trajectory.trajectory import Trajectory


def swinging(samples: int = 601) -> Trajectory:
    t = np.arange(samples) / 120
    return Trajectory(("t", "x"), np.column_stack([t, np.exp(-t) * np.sin(4 * t)]))


@pytest.mark.parametrize(
    "text",
    ["eventually x <= 1", "always[0,1] x <= 1", "x <= 1", "x <= 1 until x >= 0", "not always x <= 1"],
)
def test_a_specification_of_another_form_has_no_margins(text: str) -> None:
    assert margins(parse_formula(text), swinging()) is None


@pytest.mark.parametrize(
    "text", ["always abs(x) <= 1", "always (x <= 1 or x >= 2) and always x >= -0.9", "not eventually x > 0.5"]
)
def test_the_least_margin_is_the_robustness(text: str) -> None:
    tree, trajectory = parse_formula(text), swinging()
    found = margins(tree, trajectory)
    assert found is not None
    assert found.shape == (601,)
    assert found.min() == robustness(tree, trajectory.columns, trajectory.samples)

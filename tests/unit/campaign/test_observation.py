"""From the trajectories of a test to y, with trajectories made by hand."""

import numpy as np
import pytest

from perfbound.orchestrator.campaign.observation import Observer
from perfbound.orchestrator.campaign.plan import plan
from perfbound.orchestrator.mathematics.stl.parser import FormulaError
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from tests.campaigns import config

SPEC = SystemSpec(
    name="segway",
    doc="",
    parameters=(Parameter(name="x", unit="m", low=0, high=5), Parameter(name="y", unit="m", low=0, high=5)),
    columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
    max_horizon=60,
)


def trajectory(*phi: float) -> Trajectory:
    return Trajectory(("t", "phi"), np.column_stack([np.arange(len(phi)) * 0.1, phi]))


def observe(campaign: str, trajectories: dict[tuple[str, int], Trajectory], problem: int = 0) -> float:
    chosen = config(campaign)
    return Observer(chosen, SPEC).observe(plan(chosen, SPEC, chosen.problems[problem]), trajectories).y


def test_nominal_robustness_is_minus_the_mean_of_the_clipped_robustness() -> None:
    # .95 - .5 = .45;  .95 - .1 = .85, clipped to .75
    trajectories = {("nominal", 0): trajectory(0.1, -0.5), ("nominal", 1): trajectory(0.1, 0.0)}
    assert observe("segway-paper", trajectories) == pytest.approx(-(0.45 + 0.75) / 2)


def test_a_fall_scores_the_lower_clip() -> None:
    assert observe("segway-paper", {("nominal", 0): trajectory(0.0, 3.0)}) == 0.05


def test_sim_gap_is_the_largest_difference_in_the_column_and_is_not_clipped() -> None:
    trajectories = {("nominal", 0): trajectory(0.0, 0.1, 0.2), ("true", 0): trajectory(0.0, -1.3, 0.2)}
    assert observe("segway-paper", trajectories, problem=1) == pytest.approx(1.4)


def test_true_risk_uses_the_sample_standard_deviation() -> None:
    values = [0.55, 0.65, 0.7, 0.6] + [0.6] * 6
    trajectories = {("true", r): trajectory(0.0, 0.95 - value) for r, value in enumerate(values)}
    expected = -(np.mean(values) - 0.2 * np.std(values, ddof=1))
    assert observe("segway-direct", trajectories) == pytest.approx(expected)


def test_a_formula_over_a_column_that_the_system_lacks_is_refused() -> None:
    with pytest.raises(FormulaError, match="psi"):
        Observer(config("segway-paper", specification="always (abs(psi) <= 1)"), SPEC)

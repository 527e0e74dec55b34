"""Trajectories to the value of a test."""

import math
import random
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.campaign.objectives import clipped, column_maximum, mean, risk, scored, signal_sup
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.schemas.trajectory.trajectory import Trajectory

COLUMNS = ("t", "phi")
SPECIFICATION = parse_formula("always (abs(phi) <= 0.95)")
CLIP = (-0.05, 0.75)


def trace(*phi: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.stack([np.arange(len(phi)) / 120, np.array(phi)], axis=1)


@pytest.mark.parametrize(("worst", "expected"), [(0.24, 0.71), (0.0, 0.75), (1.5, -0.05)])
def test_robustness_is_clipped(worst: float, expected: float) -> None:
    rollout = Trajectory(COLUMNS, trace(0.0, -worst))
    assert clipped(scored(SPECIFICATION, rollout, None).robustness, CLIP) == pytest.approx(expected)


def test_an_empty_clip_is_refused() -> None:
    with pytest.raises(ValueError, match="clip"):
        clipped(0.0, (0.75, -0.05))


def test_a_nan_is_never_a_score() -> None:
    with pytest.raises(ValueError, match="not a finite number"):
        signal_sup(1, trace(0.0, math.nan), trace(0.0, 0.0))
    with pytest.raises(ValueError, match="not a finite number"):
        column_maximum(1, trace(0.0, math.nan))
    with pytest.raises(ValueError, match="not a finite number"):
        mean([0.0, math.nan])


def test_signal_sup() -> None:
    assert signal_sup(1, trace(0.1, 0.5, -0.2), trace(0.1, 0.25, 0.2)) == pytest.approx(0.4)


def test_signal_sup_is_not_clipped() -> None:
    assert signal_sup(1, trace(0.0, 9.0), trace(0.0, 0.0)) == 9.0


def test_signal_sup_refuses_different_grids() -> None:
    with pytest.raises(ValueError, match="2 and 3 samples"):
        signal_sup(1, trace(0.0, 1.0), trace(0.0, 1.0, 2.0))
    late = trace(0.0, 1.0)
    late[1, 0] += 1e-12
    assert signal_sup(1, trace(0.0, 1.0), late) == 0.0, "the same instant"
    late[1, 0] += 0.02 * late[1, 0]
    with pytest.raises(ValueError, match="differ at sample 1"):
        signal_sup(1, trace(0.0, 1.0), late)


def test_column_maximum() -> None:
    assert column_maximum(1, trace(0.1, 0.5, -0.9)) == 0.5


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=20), st.floats(0, 2), st.randoms())
def test_mean_and_risk(values: list[float], weight: float, rng: random.Random) -> None:
    shuffled = rng.sample(values, len(values))
    assert mean(values) == mean(shuffled) == pytest.approx(statistics.fmean(values), abs=1e-15)
    assert risk(values, weight) == risk(shuffled, weight)
    assert risk(values, weight) == pytest.approx(np.mean(values) - weight * np.std(values, ddof=1), abs=1e-12)


def test_refusals() -> None:
    with pytest.raises(ValueError, match="at least one rollout"):
        mean([])
    with pytest.raises(ValueError, match="at least 2 replicates"):
        risk([0.5], 0.2)
    with pytest.raises(ValueError, match="risk_weight"):
        risk([0.5, 0.6], -0.2)

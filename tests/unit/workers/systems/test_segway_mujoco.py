"""The Segway in MuJoCo: the same plant and controller as in PyBullet, alone and in batches."""

import math
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import SimulationError, UnknownSystemError
from perfbound.schemas.trajectory.trajectory import Floats
from perfbound.workers.systems import load_system
from perfbound.workers.systems.base import Cancelled
from perfbound.workers.systems.segway import SegwaySystem, controller
from perfbound.workers.systems.segway.controller import GAINS
from perfbound.workers.systems.segway_mujoco import MujocoSegway, system, world
from tests.fakes.segway import STILL, errors

SYSTEM = MujocoSegway()
WORLD = world.MujocoWorld()
PHI = [each.name for each in SYSTEM.spec.columns].index("phi")
GRID = [(x, y) for x in range(6) for y in range(6)]
KEYS: dict[str, Any] = {"variant": "nominal", "horizon": 15.0, "options": {}, "progress": lambda _: None}


def alone(x: float, y: float, disturbances: Any = STILL, **keys: Any) -> Floats:
    return SYSTEM.rollout((x, y), seed=0, **{**KEYS, **keys}, disturbances=disturbances).samples


def together(starts: Any, disturbances: Any = STILL, **keys: Any) -> Any:
    starts = np.array(starts, dtype=float)
    arrays = {name: np.broadcast_to(np.array(each, dtype=float), len(starts)) for name, each in disturbances.items()}
    seeds = np.zeros(len(starts), dtype=np.uint64)
    return SYSTEM.rollouts(starts, seeds=seeds, **{**KEYS, **keys}, disturbances=arrays)


@pytest.mark.parametrize("gains", GAINS)
def test_on_36_starts_the_largest_tilt_is_that_of_pybullet(gains: str) -> None:
    other = SegwaySystem()
    found = np.abs(together(GRID, options={"gains": gains})[:, :, PHI]).max(axis=1)
    expected = [
        np.abs(
            other.rollout(x, seed=0, **{**KEYS, "options": {"gains": gains}}, disturbances=STILL).column("phi")
        ).max()
        for x in GRID
    ]
    assert np.abs(found - expected).max() <= 8e-3


def test_the_description_is_that_of_pybullet() -> None:
    other, spec = SegwaySystem().spec, SYSTEM.spec
    for key in ("parameters", "columns", "options", "disturbances", "variants", "noisy", "residual", "max_horizon"):
        assert getattr(spec, key) == getattr(other, key), key
    assert spec.vectorised
    assert not spec.batch_is_the_unit
    code = load_system("segway-mujoco").spec.code
    assert {name.rpartition("/")[2] for name in code} >= {"world.py", "model.xml", "controller.py", "system.py"}


@pytest.mark.parametrize("variant", ["nominal", "true"])
def test_a_rollout_has_the_same_bits_alone_and_in_any_batch(variant: Any) -> None:
    drawn = [errors(seed) if variant == "true" else STILL for seed in range(9)]
    starts = [(0.5 * k, 5.0 - k / 3) for k in range(8)] + [(2.5, 2.5)]
    arrays = {name: np.array([each[name] for each in drawn]) for name in STILL}
    batch = together(starts, arrays, variant=variant, horizon=3.0)
    order = [4, 8, 0]
    part = together([starts[k] for k in order], {n: a[order] for n, a in arrays.items()}, variant=variant, horizon=3.0)
    assert np.array_equal(part, batch[order])
    for k, start in enumerate(starts):
        assert np.array_equal(alone(*start, drawn[k], variant=variant, horizon=3.0), batch[k]), k


def test_a_fallen_segway_stays_where_it_fell_and_disturbs_no_other() -> None:
    tilts = [0.0, 1.5, 0.7, math.pi / 3]
    tilted = {**STILL, "phi_error": np.array(tilts)}
    batch = together([(1.0, 1.0)] * 4, tilted, horizon=4.0)
    for k in (1, 3):
        assert (batch[k, :, 1:] == batch[k, 0, 1:]).all(), "fallen from the first row"
        assert np.array_equal(alone(1.0, 1.0, {**STILL, "phi_error": tilts[k]}, horizon=4.0), batch[k])
    assert abs(batch[2, -1, PHI]) < 0.2, "it recovers"
    assert np.array_equal(alone(1.0, 1.0, horizon=4.0), batch[0])


def test_the_controller_is_that_of_pybullet() -> None:
    random = np.random.default_rng(5)
    for gains in GAINS.values():
        for x, y, heading, vx, vy, phi, phidot, rate in random.uniform(-3, 6, (100, 8)).tolist():
            speed = vx * math.cos(heading) + vy * math.sin(heading)
            found = world.voltages((x, y, heading, speed, phi, phidot, rate), gains)
            expected = controller.voltages((x, y, heading, vx, vy, phi, phidot, rate), gains)
            assert found == pytest.approx(expected, abs=1e-9)
    assert world.voltages((2.5, 2.5, 0.0, 0.0, 0.0, 0.0, 0.0), GAINS["paper"]) == (0.0, 0.0)


def test_what_is_not_finite_never_reaches_the_engine() -> None:
    still = np.zeros((2, 4))
    still[1, 3] = np.nan
    with pytest.raises(SimulationError, match="not finite"):
        WORLD.rollouts(still, 10, GAINS["paper"], lambda _: None)
    with pytest.raises(SimulationError, match="not finite"):
        WORLD.rollout(still[1], 10, GAINS["paper"], lambda _: None)
    with pytest.raises(SimulationError, match=r"x = 26\.0 is outside"):
        together([(1.0, 1.0), (26.0, 1.0)])


def test_a_rollout_that_is_not_stable_fails_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By torques that no motor has."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(world, "MOTOR_CONSTANT", np.array([1.0, 1e300]))
    found = WORLD.rollouts(np.array([[1.0, 1.0, 0.0, 0.1]] * 2), 60, GAINS["paper"], lambda _: None)
    assert np.isfinite(found[0]).all()
    assert not np.isfinite(found[1]).all()
    monkeypatch.setattr(world, "MOTOR_CONSTANT", 1e300)
    with pytest.raises(SimulationError, match="not stable"):
        WORLD.rollout(np.array([1.0, 1.0, 0.0, 0.1]), 60, GAINS["paper"], lambda _: None)
    assert not list(tmp_path.iterdir()), "MuJoCo writes a log there by itself"


@pytest.mark.parametrize("many", [False, True])
def test_progress_lets_the_cancellation_through(many: bool) -> None:
    def progress(step: int) -> None:
        if step:
            raise Cancelled

    with pytest.raises(Cancelled):
        (together([(1.0, 1.0)], progress=progress) if many else alone(1.0, 1.0, progress=progress))


def test_without_mujoco_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(system, "version", missing)
    with pytest.raises(UnknownSystemError, match=r"pip install 'perfbound\[mujoco\]'"):
        _ = MujocoSegway().spec

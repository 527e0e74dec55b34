"""The Segway against its specification and the nine traps of its simulator."""

import hashlib
import math
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from perfbound.schemas.errors import SimulationError
from perfbound.schemas.system import OptionValue
from perfbound.schemas.trajectory.trajectory import Floats, Trajectory, decode, encode
from perfbound.workers.systems.base import Cancelled
from perfbound.workers.systems.segway import SegwaySystem, bullet, controller
from perfbound.workers.systems.segway.bullet import StartPose, World
from perfbound.workers.systems.segway.controller import GAINS, GOAL, State, voltages
from tests.fakes.segway import STILL, errors

SYSTEM = SegwaySystem()
PHI = SYSTEM.spec.columns.index(next(column for column in SYSTEM.spec.columns if column.name == "phi"))


def rollout(
    *x: float, variant: Any = "nominal", seed: int = 0, horizon: float = 15.0, **options: OptionValue
) -> Trajectory:
    return SYSTEM.rollout(
        x,
        variant=variant,
        seed=seed,
        horizon=horizon,
        options=options,
        progress=lambda _: None,
        disturbances=errors(seed) if variant == "true" else STILL,
    )


def from_start(start: StartPose, *, seconds: float = 15.0, gains: str = "paper") -> Floats:
    return WORLD.rollout(start, round(120 * seconds), GAINS[gains], lambda _: None)


def rho(samples: Floats) -> float:
    """Robustness of always (abs(phi) <= 0.95), clipped."""
    return float(np.clip(0.95 - np.abs(samples[:, PHI]).max(), -0.05, 0.75))


def digest(trajectory: Trajectory) -> str:
    return hashlib.sha256(trajectory.samples.tobytes()).hexdigest()


WORLD = World()


@pytest.fixture(scope="module")
def corner() -> Trajectory:
    """The worst nominal start."""
    return rollout(5.0, 0.0)


@pytest.fixture
def free() -> Iterator[World]:
    """A world of its own, for tests that break it."""
    world = World()
    yield world
    world._bullet.disconnect(world._client)


# Against the specification


@pytest.mark.parametrize(("gains", "expected"), [("paper", 0.709), ("aggressive", 0.463)])
def test_the_corner_has_the_published_robustness(gains: str, expected: float) -> None:
    for y in (0.0, 5.0):
        assert rho(rollout(5.0, y, gains=gains).samples) == pytest.approx(expected, abs=1e-3)


def test_it_reaches_the_goal(corner: Trajectory) -> None:
    assert math.dist(corner.samples[-1, 1:3], GOAL) < 0.02
    assert corner.samples.shape == (1801, 10)
    assert corner.column("t")[-1] == 15.0
    assert len(rollout(1.0, 1.0, horizon=0.25).samples) == 31
    assert len(rollout(1.0, 1.0, horizon=0.0).samples) == 1


def test_the_columns_are_those_of_the_axle(corner: Trajectory) -> None:
    assert corner.columns == tuple(column.name for column in SYSTEM.spec.columns)
    assert corner.samples[0, 1:8] == pytest.approx([5, 0, 0, 0, 0, 0, 0], abs=1e-12)
    for place, rate in (("x", "vx"), ("y", "vy"), ("phi", "phidot")):
        derivative = np.gradient(corner.column(place), corner.column("t"))[1:-1]
        assert derivative == pytest.approx(corner.column(rate)[1:-1], abs=0.05)
    assert np.abs(corner.column("voltage_left")).max() <= 20


def test_a_tilted_start_turns_about_the_axle() -> None:
    samples = from_start(StartPose(1.0, 2.0, 0.3, -0.4), seconds=0)
    assert samples[0, 1:8] == pytest.approx([1.0, 2.0, 0.3, 0, 0, -0.4, 0], abs=1e-12)


@pytest.mark.rest
def test_a_true_start_is_off_by_its_disturbances_and_nothing_else_is_random() -> None:
    assert digest(rollout(1.0, 2.0, seed=1, horizon=1)) == digest(rollout(1.0, 2.0, seed=2, horizon=1))
    first = rollout(1.0, 2.0, variant="true", seed=9, horizon=0).samples[0]
    assert first[[1, 2, 3, PHI]] - (1, 2, 0, 0) == pytest.approx(list(errors(9).values()), abs=1e-12)
    assert not first[4:6].any()  # at rest
    common: Any = {"horizon": 1.0, "options": {}, "progress": lambda _: None}
    silent = SYSTEM.rollout((1.0, 2.0), variant="true", seed=3, disturbances=STILL, **common)
    assert digest(silent) == digest(rollout(1.0, 2.0, horizon=1))
    again = [SYSTEM.rollout((1.0, 2.0), variant="true", seed=n, disturbances=errors(9), **common) for n in (1, 2)]
    assert digest(again[0]) == digest(again[1])


def test_the_declared_laws_are_those_of_the_paper() -> None:
    assert [each.words for each in SYSTEM.spec.disturbances] == [
        "normal, mean 0 m, sd 0.223607 m",
        "normal, mean 0 m, sd 0.223607 m",
        "normal, mean 0 rad, sd 0.223607 rad",
        "normal, mean 0 rad, sd 0.223607 rad",
    ]
    assert (SYSTEM.spec.residual, SYSTEM.spec.noisy) == (False, ("true",))


def test_what_is_outside_the_spec_is_refused() -> None:
    for options in ({"gains": "soft"}, {"gains": 2.0}, {"mass": 3.0}):
        with pytest.raises(SimulationError):
            rollout(1.0, 1.0, **options)
    for x in ((1.0,), (1.0, 2.0, 3.0), (26.0, 0.0)):
        with pytest.raises(SimulationError):
            rollout(*x)
    with pytest.raises(SimulationError, match="horizon"):
        rollout(1.0, 1.0, horizon=121)


def test_progress_counts_and_lets_the_cancellation_through() -> None:
    steps: list[int] = []
    common: Any = {"variant": "nominal", "seed": 0, "horizon": 2, "options": {}, "disturbances": STILL}
    SYSTEM.rollout((1.0, 1.0), **common, progress=steps.append)
    assert steps == [0, 60, 120, 180]
    before = digest(rollout(1.0, 1.0, horizon=1))

    def cancel(step: int) -> None:
        if step:
            raise Cancelled

    with pytest.raises(Cancelled):
        SYSTEM.rollout((4.0, 1.0), **common, progress=cancel)
    assert digest(rollout(1.0, 1.0, horizon=1)) == before


# The controller


def linearised() -> tuple[Floats, Floats]:
    """A, B of [v, phi, phidot] from the parameters of the model (a wheeled inverted pendulum upright at rest)."""
    mass, wheel, axle, inertia, arm, radius = 44.798, 2.485, 0.0559366, 3.83629, bullet.CENTRE_OF_MASS, 0.195
    km, b = bullet.MOTOR_CONSTANT, bullet.MOTOR_DAMPING
    inverse = np.linalg.inv(
        [[mass + 2 * wheel + 2 * axle / radius**2, mass * arm], [mass * arm, inertia + mass * arm**2]]
    )
    forces = [[-2 * b / radius**2, 0, 2 * b / radius], [2 * b / radius, mass * 9.81 * arm, -2 * b]]
    (dv, ddphi), (bv, bphi) = inverse @ forces, inverse @ [2 * km / radius, -2 * km]
    return np.array([dv, [0, 0, 1], ddphi]), np.array([[bv], [0], [bphi]])


def test_the_linearised_model_is_the_published_one() -> None:
    a, b = linearised()
    published = [[-0.38956, -2.63188, 0.07597], [0, 0, 1], [1.05546, 18.38306, -0.20581]]
    assert a == pytest.approx(np.array(published), abs=1e-5)
    assert b[:, 0] == pytest.approx([0.40106, 0, -1.08661], abs=1e-5)
    assert sorted(np.linalg.eigvals(a).real) == pytest.approx([-4.48, -0.24, 4.12], abs=5e-3)


@pytest.mark.parametrize(("name", "weights"), [("paper", (1, 1, 0.1)), ("aggressive", (5, 1, 0.1))])
def test_the_gains_solve_the_lqr(name: str, weights: tuple[float, ...]) -> None:
    a, b = linearised()
    cost = solve_continuous_are(a, b, np.diag(weights), [[0.01]])
    assert (b.T @ cost / 0.01)[0] == pytest.approx(GAINS[name][:3], rel=1e-6)


def test_the_controller_is_still_at_the_goal_and_mirrors() -> None:
    gains = GAINS["aggressive"]
    assert voltages((*GOAL, 1.0, 0, 0, 0, 0, 0), gains) == (0.0, 0.0)
    left, right = voltages((1.0, 1.5, 0.2, 0.3, 0.1, 0.01, 0.02, 0.1), gains)
    assert voltages((1.0, 3.5, -0.2, 0.3, -0.1, 0.01, 0.02, -0.1), gains) == pytest.approx((right, left))
    assert voltages((2.0, 2.0, 0, 0, 0, -1.0, 0, 0), gains) == (-20.0, -20.0)
    assert voltages((2.0, 2.0, 0, 0, 0, 1.0, 0, 0), gains) == (20.0, 20.0)


@pytest.mark.parametrize("place", range(8))
def test_the_controller_hides_no_nan(place: int) -> None:
    state: Any = [1.0] * 8
    state[place] = math.nan
    assert all(map(math.isnan, voltages(tuple(state), GAINS["paper"])))


# The traps, numbered as in the specification of the system


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_trap_1_a_start_that_is_not_finite_never_reaches_the_engine(
    bad: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(World, "_build", lambda *_: pytest.fail("the engine was asked"))
    with pytest.raises(SimulationError, match="y = "):
        rollout(1.0, bad)
    with pytest.raises(SimulationError, match="not finite"):
        WORLD.rollout(StartPose(1.0, 2.0, phi=bad), 1, GAINS["paper"], lambda _: None)


def test_trap_1_a_poisoned_client_is_rebuilt(free: World, corner: Trajectory) -> None:
    free._build(StartPose(math.nan, 0.0))
    for _ in range(10):
        free._bullet.stepSimulation(free._client)
    assert math.isnan(free._state()[0])
    assert free.rollout(StartPose(5.0, 0.0), 1800, GAINS["paper"], lambda _: None).tobytes() == corner.samples.tobytes()


@pytest.mark.parametrize(("place", "value"), [(controller.PHI, math.nan), (0, math.inf), (0, 1e200)])
def test_trap_2_a_trajectory_that_is_not_finite_is_no_score(
    place: int, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, count = World._state, iter(range(1000))

    def broken(self: World) -> State:
        found: Any = list(state(self))
        if next(count) == 20:
            found[place] = value
        return tuple(found)

    monkeypatch.setattr(World, "_state", broken)
    with pytest.raises(SimulationError, match="did not stay finite"):
        rollout(1.0, 1.0, horizon=0.5)


def test_trap_2_a_nan_inside_the_engine_is_no_score(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = World._drive
    monkeypatch.setattr(World, "_drive", lambda self, left, right: drive(self, math.nan, right))
    with pytest.raises(SimulationError, match=r"not finite: .* row 1;"):
        rollout(1.0, 1.0, horizon=0.5)
    monkeypatch.undo()
    assert rho(rollout(5.0, 0.0, horizon=0.5).samples) > 0.7


def test_trap_3_every_setting_arrived(free: World) -> None:
    free._build(StartPose(1.0, 1.0))
    info = [free._bullet.getDynamicsInfo(free._segway, link, free._client) for link in (-1, 0, 1)]
    assert [link[0] for link in info] == [44.798, 2.485, 2.485]
    assert [link[1] for link in info] == [0.5, 0.9, 0.9]  # the body keeps the engine's default and touches nothing
    assert info[0][2] == (3.60496, 3.83629, 1.06967)
    assert info[1][2] == pytest.approx((0.0279683, 0.0559366, 0.0279683))
    assert free._bullet.getDynamicsInfo(0, -1, free._client)[1] == 1.0


def test_trap_3_nothing_damps_a_free_flight(free: World) -> None:
    free._build(StartPose(1.0, 1.0))
    position = free._bullet.getBasePositionAndOrientation(free._segway, free._client)[0]
    free._bullet.resetBasePositionAndOrientation(free._segway, (*position[:2], 50.0), (0, 0, 0, 1), free._client)
    free._bullet.resetBaseVelocity(free._segway, (1.0, 0, 0), (0, 0, 0.5), free._client)
    for _ in range(120):
        free._bullet.stepSimulation(free._client)
    (vx, *_), (_, _, wz) = free._bullet.getBaseVelocity(free._segway, free._client)
    assert (vx, wz) == pytest.approx((1.0, 0.5), abs=2e-3)


def test_trap_3_a_setting_that_did_not_arrive_is_an_error(free: World, monkeypatch: pytest.MonkeyPatch) -> None:
    class Deaf:
        def __getattr__(self, name: str) -> Any:
            return (lambda *_, **__: None) if name == "changeDynamics" else getattr(WORLD._bullet, name)

    monkeypatch.setattr(free, "_bullet", Deaf())
    with pytest.raises(SimulationError, match="friction"):
        free.rollout(StartPose(1.0, 1.0), 1, GAINS["paper"], lambda _: None)


def test_trap_4_a_fallen_segway_stays_where_it_fell() -> None:
    samples = from_start(StartPose(5.0, 0.0, phi=0.99, heading=0.3), gains="aggressive")
    fallen = int(np.argmax(np.abs(samples[:, PHI]) > 1.0))
    assert 0 < fallen < 200
    assert rho(samples) == -0.05
    assert (samples[fallen:, 1:] == samples[fallen, 1:]).all()
    assert samples[:, 0] == pytest.approx(np.arange(1801) / 120, abs=0)
    assert math.dist(samples[-1, 1:3], samples[0, 1:3]) < 5


@pytest.mark.parametrize("phi", [-0.95, -0.8, 0.8, 0.95])
def test_trap_4_a_tilted_start_recovers(phi: float) -> None:
    samples = from_start(StartPose(2.0, 1.0, phi=phi), seconds=4)
    assert rho(samples) == pytest.approx(0.95 - abs(phi), abs=1e-9)
    assert abs(samples[-1, PHI]) < 0.2


@pytest.mark.parametrize("phi", [-3.0, -1.1, 1.1])
def test_trap_4_a_start_on_the_ground_has_fallen(phi: float) -> None:
    samples = from_start(StartPose(2.0, 1.0, phi=phi), seconds=1)
    assert rho(samples) == -0.05
    assert (samples[:, 1:] == samples[0, 1:]).all()


def test_trap_5_too_little_friction_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    start = StartPose(5.0, 0.0, heading=0.2, phi=0.8)
    assert rho(from_start(start, seconds=5)) == pytest.approx(0.15)
    monkeypatch.setattr(bullet, "WHEEL_FRICTION", 0.3)
    assert rho(from_start(start, seconds=5)) == -0.05


def test_trap_6_a_second_client_does_not_disturb(free: World, corner: Trajectory) -> None:
    """Rendering happens in a client of its own, with bodies of its own, also between two steps."""
    free._build(StartPose(5.0, 0.0))

    def render(step: int) -> None:
        shape = free._bullet.createCollisionShape(free._bullet.GEOM_SPHERE, 0.1, physicsClientId=free._client)
        free._bullet.createMultiBody(1.0, shape, physicsClientId=free._client)
        free._bullet.getCameraImage(32, 24, renderer=free._bullet.ER_TINY_RENDERER, physicsClientId=free._client)

    common: Any = {"variant": "nominal", "seed": 0, "horizon": 15, "options": {}, "disturbances": STILL}
    again = SYSTEM.rollout((5.0, 0.0), **common, progress=render)
    assert digest(again) == digest(corner)


def test_trap_7_a_goal_exactly_behind() -> None:
    scores = [rho(from_start(StartPose(4.5, 2.5 + offset))) for offset in (-1e-9, 0.0, 1e-9)]
    assert scores == pytest.approx([scores[1]] * 3, abs=5e-4)


def test_trap_8_equal_in_one_process_whatever_ran_before(corner: Trajectory) -> None:
    rollout(3.0, 4.0, variant="true", seed=9, horizon=2)
    from_start(StartPose(1.0, 1.0, phi=1.2), seconds=0.1)
    assert digest(rollout(5.0, 0.0)) == digest(corner)
    assert rollout(5.0, 0.0).samples == pytest.approx(corner.samples, abs=0)


@pytest.mark.integration
def test_trap_8_equal_in_a_fresh_process(corner: Trajectory) -> None:
    code = (
        "import hashlib; from perfbound.workers.systems.segway import SegwaySystem\n"
        "found = SegwaySystem().rollout((5.0, 0.0), variant='nominal', seed=0, horizon=15, options={}, "
        f"progress=lambda step: None, disturbances={STILL})\n"
        "print(hashlib.sha256(found.samples.tobytes()).hexdigest())"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == digest(corner)


@pytest.mark.parametrize("x", [(5.0, 0.0), (0.0, 1.0), (3.3, 0.2)])
@pytest.mark.parametrize("gains", GAINS)
def test_trap_9_the_mirror_image_scores_the_same(x: tuple[float, float], gains: str) -> None:
    mirrored = rho(rollout(x[0], 5 - x[1], gains=gains).samples)
    assert rho(rollout(*x, gains=gains).samples) == pytest.approx(mirrored, abs=5e-4)


def test_trap_9_the_place_in_the_world_does_not_matter(corner: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller, "GOAL", (GOAL[0] + 3.3, GOAL[1] - 1.7))
    moved = from_start(StartPose(8.3, -1.7))
    assert rho(moved) == pytest.approx(rho(corner.samples), abs=1e-12)
    moved[:, 1:3] -= (3.3, -1.7)
    assert moved[:, 1:8] == pytest.approx(corner.samples[:, 1:8], abs=5e-12)


# The visual part


def test_the_visual_follows_the_trajectory() -> None:
    trajectory = rollout(5.0, 1.0, horizon=2)
    seen = SYSTEM.visual(trajectory)
    base, pendulum = seen.transforms
    assert (base.parent, base.child, pendulum.parent, pendulum.child) == ("world", "base_link", "base_link", "pendulum")
    assert base.translation[:, :2] == pytest.approx(trajectory.samples[trajectory.frames, 1:3])
    assert 2 * np.arctan2(pendulum.rotation[:, 1], pendulum.rotation[:, 3]) == pytest.approx(
        trajectory.samples[trajectory.frames, PHI]
    )
    assert seen.scene is not None
    assert {entity.frame_id for entity in seen.scene.entities} == {"world", "base_link", "pendulum"}
    assert all(entity.frame_locked for entity in seen.scene.entities)


def test_the_log_says_that_it_fell() -> None:
    fallen = Trajectory(rollout(1.0, 1.0, horizon=0).columns, from_start(StartPose(1.0, 1.0, phi=1.2), seconds=1))
    assert [text for _, text in SYSTEM.visual(fallen).log][-1].startswith("fallen")
    assert len(SYSTEM.visual(rollout(1.0, 1.0, horizon=1)).log) == 2


def test_the_file_shows_the_scene() -> None:
    import io
    from dataclasses import replace

    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    plain = rollout(5.0, 1.0, horizon=0.5)
    shown = replace(plain, visual=SYSTEM.visual(plain))
    units = {column.name: column.unit for column in SYSTEM.spec.columns}
    data = encode(shown, request={}, metadata={}, units=units)
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    ((_, _, _, scene),) = reader.iter_decoded_messages("/scene")
    usual = SYSTEM.visual(plain).scene
    assert scene is not None
    assert usual is not None
    assert scene.SerializeToString(deterministic=True) == usual.SerializeToString(deterministic=True)
    assert digest(decode(data)) == digest(plain)

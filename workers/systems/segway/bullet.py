"""The world of the Segway in PyBullet.

The world is rebuilt for every rollout: a client that is used again keeps contacts, and one rollout with a NaN
would give the next ones wrong, finite results.
"""

import importlib
import math
import os
import sys
from array import array
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....schemas.errors import SimulationError, UnknownSystemError
from ....schemas.trajectory.trajectory import Floats
from ..base import Progress
from .controller import HEADING_RATE, PHI, Gains, State, voltages

CONTROL_RATE = 120  # 1/s
SUB_STEPS = 2  # physics steps per control step, under one torque
WHEEL_RADIUS = 0.195  # m
CENTRE_OF_MASS = 0.168455  # m above the axle
MOTOR_CONSTANT = 1.26165  # N m/V
MOTOR_DAMPING = 0.238968  # N m s/rad, on the rate of the wheel against the body
WHEEL_FRICTION = 0.9  # below 0.5 a noisy start slips and falls
FALLEN = 1.0  # rad; a Segway that lies on the ground would slide away
PROGRESS_STEPS = 60
COLUMNS = 10  # t, a State without its heading_rate, two voltages

NEEDS = (
    "segway: no installed package provides the module pybullet, which has wheels for Python 3.11 alone; "
    "use Python 3.11, or install a fork for later versions: pip install pybullet-arm64"
)

_MODEL = str(Path(__file__).with_name("model.urdf"))
_BODY, _WHEELS = -1, (0, 1)  # links of the model
_UNUSED = (0.0, 0.0)  # targets and gains, which torque control ignores: keyword arguments would cost a rollout 3 %


class StartPose(NamedTuple):
    """The pose at the start of a rollout, at rest: m, m, rad, rad."""

    x: float
    y: float
    heading: float = 0.0
    phi: float = 0.0


class World:
    """One PyBullet client without display, for one rollout after the other."""

    def __init__(self) -> None:
        self._bullet: Any = _pybullet()
        self._client: int = self._bullet.connect(self._bullet.DIRECT)
        self._segway = -1

    def rollout(self, start: StartPose, steps: int, gains: Gains, progress: Progress) -> Floats:
        """Simulate `steps` control steps and return one row per step and one for the end, shape (steps + 1, 10).

        From the step at which it has fallen on, the last state is held.

        Raises:
            SimulationError: the start is not finite, or the engine did not take a setting.
            Cancelled: raised by `progress`.

        """
        if not all(map(math.isfinite, start)):
            raise SimulationError(f"the start {start} is not finite")
        self._build(start)
        step_simulation, client = self._bullet.stepSimulation, self._client
        rows = array("d")  # a list would keep 18,000 floats alive, which costs more than copying them
        for step in range(steps + 1):
            state = self._state()
            volts = voltages(state, gains)
            rows.extend(state + volts)
            if step == steps or abs(state[PHI]) > FALLEN:
                break
            if step % PROGRESS_STEPS == 0:
                progress(step)
            self._drive(*volts)
            step_simulation(client)
        return _held(np.frombuffer(rows).reshape(-1, len(state + volts)), steps)

    def _build(self, start: StartPose) -> None:
        bullet, client = self._bullet, self._client
        bullet.resetSimulation(physicsClientId=client)
        bullet.setGravity(0, 0, -9.81, physicsClientId=client)
        bullet.setPhysicsEngineParameter(fixedTimeStep=1 / CONTROL_RATE, numSubSteps=SUB_STEPS, physicsClientId=client)
        shape = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        unseen = bullet.URDF_IGNORE_VISUAL_SHAPES  # this world is never rendered
        ground = bullet.createMultiBody(0, shape, flags=unseen, physicsClientId=client)
        self._segway = bullet.loadURDF(
            _MODEL,
            (start.x, start.y, WHEEL_RADIUS),
            bullet.getQuaternionFromEuler((0.0, start.phi, start.heading)),
            flags=bullet.URDF_USE_INERTIA_FROM_FILE | unseen,
            physicsClientId=client,
        )
        self._set_friction(ground, _BODY, 1.0)  # the contact uses the product
        for wheel in _WHEELS:
            self._set_friction(self._segway, wheel, WHEEL_FRICTION)
        # Never together with a friction: bullet3 #3314 then applies all of it to the base.
        bullet.changeDynamics(self._segway, _BODY, linearDamping=0, angularDamping=0, physicsClientId=client)
        # The joints come with a velocity motor that holds them.
        bullet.setJointMotorControlArray(
            self._segway, _WHEELS, bullet.VELOCITY_CONTROL, forces=(0.0, 0.0), physicsClientId=client
        )

    def _set_friction(self, body: int, link: int, friction: float) -> None:
        self._bullet.changeDynamics(body, link, lateralFriction=friction, physicsClientId=self._client)
        found = self._bullet.getDynamicsInfo(body, link, physicsClientId=self._client)[1]
        if found != friction:
            raise SimulationError(f"pybullet set the friction of link {link} to {found}, not {friction}")

    def _state(self) -> State:
        (x, y, _), (qx, qy, qz, qw) = self._bullet.getBasePositionAndOrientation(self._segway, self._client)
        (vx, vy, _), (wx, wy, wz) = self._bullet.getBaseVelocity(self._segway, self._client)
        heading = math.atan2(2 * (qw * qz - qx * qy), 1 - 2 * (qx * qx + qz * qz))  # atan2(-R01, R11)
        up_x, up_y, up_z = 2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)
        phi = math.atan2(2 * (qw * qy - qx * qz), up_z)  # atan2(-R20, R22)
        # PyBullet's position is that of the centre of mass; the columns are those of the axle below it.
        rx, ry, rz = CENTRE_OF_MASS * up_x, CENTRE_OF_MASS * up_y, CENTRE_OF_MASS * up_z
        phidot = wy * math.cos(heading) - wx * math.sin(heading)
        return x - rx, y - ry, heading, vx - wy * rz + wz * ry, vy - wz * rx + wx * rz, phi, phidot, wz

    def _drive(self, left: float, right: float) -> None:
        bullet, segway, client = self._bullet, self._segway, self._client
        (_, left_rate, _, _), (_, right_rate, _, _) = bullet.getJointStates(segway, _WHEELS, client)
        torques = (
            MOTOR_CONSTANT * left - MOTOR_DAMPING * left_rate,
            MOTOR_CONSTANT * right - MOTOR_DAMPING * right_rate,
        )
        bullet.setJointMotorControlArray(
            segway, _WHEELS, bullet.TORQUE_CONTROL, _UNUSED, _UNUSED, torques, _UNUSED, _UNUSED, client
        )


def providers() -> dict[str, str]:
    """Return name and version of the installed packages that provide the simulator; a fork has a name of its own.

    Raises:
        UnknownSystemError: there is none.

    """
    # `packages_distributions` reads every record line by line: 0.1 s at the start of every worker, instead of 0.02 s.
    found = {
        each.name: each.version for each in distributions() if "\npybullet." in f"\n{each.read_text('RECORD') or ''}"
    }
    if not found:
        raise UnknownSystemError(NEEDS)
    return found


def _pybullet() -> Any:
    """Import the simulator: late, because the registry and the spec must not cost it; and without its first line.

    It prints its build time on the C library's stderr, which is the terminal of the campaign.
    """
    sys.stderr.flush()
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def _held(rows: Floats, steps: int) -> Floats:
    """Return the columns of a trajectory: a State and two voltages a row, the last one held up to `steps + 1` rows."""
    done, held = len(rows), np.empty((steps + 1, COLUMNS))
    held[:, 0] = np.arange(steps + 1) / CONTROL_RATE
    held[:done, 1:] = np.delete(rows, HEADING_RATE, axis=1)
    held[done:, 1:] = held[done - 1, 1:]
    return held

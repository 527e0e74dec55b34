"""The world of the Segway in MuJoCo: many rollouts step by step, or one, with the same bits.

| symbol | name     | meaning                                                                     | shape   |
|--------|----------|-----------------------------------------------------------------------------|---------|
| R      |          | rollouts of a batch                                                         | ()      |
| q      | `qpos`   | x, y, z of the axle's middle, a unit quaternion (w, x, y, z), two wheels    | (9, R)  |
| v      | `qvel`   | its velocity in the world, rates in the body, two wheels                    | (8, R)  |
"""

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout as batched

from ....schemas.errors import SimulationError
from ....schemas.trajectory.trajectory import Floats
from ..base import Progress
from ..mujoco_warnings import WARNINGS, listen
from ..segway.bullet import (
    COLUMNS,
    CONTROL_RATE,
    FALLEN,
    MOTOR_CONSTANT,
    MOTOR_DAMPING,
    PROGRESS_STEPS,
    SUB_STEPS,
    WHEEL_RADIUS,
)
from ..segway.controller import GOAL, MAX_VOLTAGE, STOP_TURNING, YAW_GAIN, Gains

QPOS, QVEL = slice(1, 10), slice(10, 18)
"""Places in the state of MuJoCo, behind the time."""
PHI_COLUMN = 6
Numbers = Any
"""A float, or an array (R,): numpy's functions give both the same bits, those of `math` do not."""


class MujocoWorld:
    """The model, for one batch of rollouts after the other."""

    def __init__(self) -> None:
        listen(mujoco)
        self._model: Any = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("model.xml")))
        self._data: Any = mujoco.MjData(self._model)

    def rollout(self, start: Floats, steps: int, gains: Gains, progress: Progress) -> Floats:
        """Simulate one rollout from x, y, heading and phi (4,); return its rows (steps + 1, 10), as PyBullet's world.

        Raises:
            SimulationError: the start is not finite, or the simulation is not stable.
            Cancelled: raised by `progress`.

        """
        model, data = self._model, self._data
        first = _first_states(start[np.newaxis])[0]
        WARNINGS.clear()
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = first[QPOS], first[QVEL]
        rows = np.empty((steps + 1, COLUMNS))
        for step in range(steps + 1):
            qvel = data.qvel.tolist()
            values = _columns(data.qpos.tolist(), qvel, gains)
            rows[step, 1:] = values
            if step == steps or not abs(rows[step, PHI_COLUMN]) <= FALLEN:
                break
            if step % PROGRESS_STEPS == 0:
                progress(step)
            data.ctrl[0], data.ctrl[1] = _torques(values, qvel)
            data.qacc_warmstart[:] = 0.0  # as at each call of `mujoco.rollout`
            mujoco.mj_step(model, data, SUB_STEPS)
        if WARNINGS:
            raise SimulationError("MuJoCo warns that the simulation is not stable")
        return _timed(_held(rows, step))

    def rollouts(self, starts: Floats, steps: int, gains: Gains, progress: Progress) -> Floats:
        """Simulate from `starts` (R, 4) in one batch; return (R, steps + 1, 10), with NaN where one is not stable.

        Raises:
            SimulationError: a start is not finite.
            Cancelled: raised by `progress`.

        """
        WARNINGS.clear()
        states = _first_states(starts)
        rows = np.empty((steps + 1, COLUMNS, len(starts)))
        ended = np.full(len(starts), steps)
        with batched.Rollout(nthread=0) as pool:
            for step in range(steps + 1):
                qpos, qvel = states[:, QPOS].T, states[:, QVEL].T
                values = _columns(qpos, qvel, gains)
                for column, each in enumerate(values, start=1):
                    rows[step, column] = each
                fallen = ~(np.abs(rows[step, PHI_COLUMN]) <= FALLEN)
                ended[fallen & (ended == steps)] = step
                if step == steps or bool((ended < step).all()):
                    break
                if step % PROGRESS_STEPS == 0:
                    progress(step)
                torques = np.stack(_torques(values, qvel), axis=1)
                control = np.repeat(torques[:, np.newaxis], SUB_STEPS, axis=1)
                found, _ = pool.rollout(self._model, [self._data], states, control)
                states = found[:, -1]
        # MuJoCo stops one that is not stable: its time stands still.
        broken = (states[:, 0] < (step - 0.5) / CONTROL_RATE) & (ended == steps)
        rows[:, :, broken] = np.nan
        return np.stack([_timed(_held(rows[:, :, k].copy(), end)) for k, end in enumerate(ended.tolist())])


def _first_states(starts: Floats) -> Floats:
    """Return the states of MuJoCo (R, 18), at rest."""
    if not np.isfinite(starts).all():
        raise SimulationError("a start is not finite")
    x, y, heading, phi = starts.T
    states = np.zeros((len(starts), QVEL.stop))
    c, s, cp, sp = np.cos(heading / 2), np.sin(heading / 2), np.cos(phi / 2), np.sin(phi / 2)
    # The heading about z, then phi about the axle.
    states[:, 1:8] = np.stack([x, y, np.full(len(x), WHEEL_RADIUS), c * cp, -s * sp, c * sp, s * cp], axis=1)
    return states


def _columns(qpos: Any, qvel: Any, gains: Gains) -> tuple[Numbers, ...]:
    """Return x, y, heading, vx, vy, phi, phidot and the two voltages, of one rollout or of many."""
    x, y, _, qw, qx, qy, qz, *_ = qpos
    vx, vy, _, wx, wy, wz, *_ = qvel
    up = 1.0 - 2.0 * (qx * qx + qy * qy)
    heading = np.arctan2(2.0 * (qw * qz - qx * qy), 1.0 - 2.0 * (qx * qx + qz * qz))  # atan2(-R01, R11)
    phi = np.arctan2(2.0 * (qw * qy - qx * qz), up)  # atan2(-R20, R22)
    # Rates about the axes of the world.
    about_x = (1.0 - 2.0 * (qy * qy + qz * qz)) * wx + 2.0 * (qx * qy - qw * qz) * wy + 2.0 * (qx * qz + qw * qy) * wz
    about_y = 2.0 * (qx * qy + qw * qz) * wx + (1.0 - 2.0 * (qx * qx + qz * qz)) * wy + 2.0 * (qy * qz - qw * qx) * wz
    heading_rate = 2.0 * (qx * qz - qw * qy) * wx + 2.0 * (qy * qz + qw * qx) * wy + up * wz
    cosine, sine = np.cos(heading), np.sin(heading)
    phidot = about_y * cosine - about_x * sine
    speed = vx * cosine + vy * sine
    return x, y, heading, vx, vy, phi, phidot, *voltages((x, y, heading, speed, phi, phidot, heading_rate), gains)


def voltages(state: tuple[Numbers, ...], gains: Gains) -> tuple[Numbers, Numbers]:
    """Return the voltages of the wheels, of one rollout or of many: the law of `segway.controller`.

    `state` is x, y, heading, the speed forwards, phi, phidot and the rate of the heading.
    """
    x, y, heading, speed, phi, phidot, heading_rate = state
    ex, ey = GOAL[0] - x, GOAL[1] - y
    square = ex * ex + ey * ey
    distance = np.sqrt(square)
    angle = np.arctan2(ey, ex) - heading
    angle = (square > 0.0) * (angle - math.tau * np.rint(angle / math.tau))  # 0 at the goal, which has no direction
    v_ref = gains.v_max * np.tanh(gains.k_distance * distance * np.cos(angle) / gains.v_max)
    w_ref = gains.w_max * np.tanh(gains.k_heading * angle / gains.w_max) * square / (square + STOP_TURNING**2)
    forward = -(gains.k_speed * (speed - v_ref) + gains.k_tilt * phi + gains.k_tilt_rate * phidot)
    turn = YAW_GAIN * (w_ref - heading_rate)
    return _limited(forward - turn), _limited(forward + turn)


def _limited(voltage: Numbers) -> Numbers:
    """Return `voltage` within its limits; a NaN stays one."""
    return np.minimum(np.maximum(voltage, -MAX_VOLTAGE), MAX_VOLTAGE)


def _torques(values: tuple[Numbers, ...], qvel: Any) -> tuple[Numbers, Numbers]:
    """Return the torques of the wheels in N m, held for a control step."""
    *_, left, right = values
    return MOTOR_CONSTANT * left - MOTOR_DAMPING * qvel[6], MOTOR_CONSTANT * right - MOTOR_DAMPING * qvel[7]


def _held(rows: Floats, last: int) -> Floats:
    """Return rows (T, 10) of which the last one that was simulated is held."""
    rows[last + 1 :] = rows[last]
    return rows


def _timed(rows: Floats) -> Floats:
    rows[:, 0] = np.arange(len(rows)) / CONTROL_RATE
    return rows

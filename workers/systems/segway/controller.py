"""The controller of the Segway: a balancing LQR under a goal-seeking law.

| symbol | name | unit |
|---|---|---|
| x, y | middle of the axle | m |
| heading | yaw, 0 along x | rad |
| vx, vy | velocity of the middle of the axle | m/s |
| phi | tilt of the centre-of-mass line, forwards positive | rad |
| K | LQR gains on (v - v_ref, phi, phidot) | V s/m, V/rad, V s/rad |
"""

import math
from typing import NamedTuple

GOAL = (2.5, 2.5)  # m
MAX_VOLTAGE = 20.0  # V per wheel
YAW_GAIN = 6.0  # V s/rad
STOP_TURNING = 0.05  # m: nearer to the goal than about this, its direction no longer matters


State = tuple[float, float, float, float, float, float, float, float]
"""The input of the controller: x, y, heading, vx, vy, phi, phidot, heading_rate, in the units of the table above.

Rates are in rad/s. A bare tuple, because making a named one at every step would cost a rollout 3 %.
"""
PHI, HEADING_RATE = 5, 7  # places in a State


class Gains(NamedTuple):
    """One tuning: K comes from an LQR (a test re-derives it), `v_max` is in m/s, `w_max` in rad/s."""

    k_speed: float
    k_tilt: float
    k_tilt_rate: float
    v_max: float
    k_distance: float  # 1/s
    w_max: float
    k_heading: float  # 1/s


GAINS = {
    "paper": Gains(-11.01839389, -57.51269772, -14.91102138, 1.0, 0.5, 1.0, 1.5),
    "aggressive": Gains(-23.35309724, -86.09056163, -23.46224715, 1.5, 0.8, 1.5, 1.5),
}


def voltages(state: State, gains: Gains) -> tuple[float, float]:
    """Return the voltages of the left and the right wheel.

    >>> voltages((*GOAL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), GAINS["paper"])
    (0.0, 0.0)
    """
    x, y, heading, vx, vy, phi, phidot, heading_rate = state
    k_speed, k_tilt, k_tilt_rate, v_max, k_distance, w_max, k_heading = gains
    ex, ey = GOAL[0] - x, GOAL[1] - y
    distance = math.hypot(ex, ey)
    angle = math.remainder(math.atan2(ey, ex) - heading, math.tau) if distance else 0.0
    v_ref = v_max * math.tanh(k_distance * distance * math.cos(angle) / v_max)
    square = distance**2
    w_ref = w_max * math.tanh(k_heading * angle / w_max) * square / (square + STOP_TURNING**2)
    v = vx * math.cos(heading) + vy * math.sin(heading)
    forward = -(k_speed * (v - v_ref) + k_tilt * phi + k_tilt_rate * phidot)
    turn = YAW_GAIN * (w_ref - heading_rate)
    return _limited(forward - turn), _limited(forward + turn)


def _limited(voltage: float) -> float:
    """Return `voltage` within its limits; a NaN stays one, which min and max would turn into a voltage."""
    return MAX_VOLTAGE if voltage > MAX_VOLTAGE else -MAX_VOLTAGE if voltage < -MAX_VOLTAGE else voltage

"""The automatic ground collision avoidance of an F-16: F16 of the competition.

Aircraft: the equations and tables of Stevens and Lewis, "Aircraft Control and Simulation", appendix A. Autopilot and
inner loop: Heidlauf, Collins, Bolender and Bak, "Verification Challenges in F-16 Ground Collision Avoidance and Other
Automated Maneuvers" (ARCH 2018), with the gains of its benchmark. Own code. Left out: afterburner, which the autopilot
never demands, and position over ground, on which nothing depends.

There are no inputs, so there is only instance 1: the parameters are roll, pitch and yaw at the start, of which yaw
decides nothing. The competition of 2019 started at 4,040 ft, and its present model folder starts at 2,338 ft.
"""

import math
from functools import partial

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.fighter_tables import coefficients, thrust
from tests.studies.falsification.models.inputs import steps

END = 15.0
"""s."""
STEP = 1.0 / 30.0
"""s, of the autopilot and of the solver (RK4)."""
SPEED = 540.0
"""At the start, ft/s."""
ATTACK = math.radians(2.1215)
POWER = 9.0
"""%."""
LOW = (0.2 * math.pi, -0.4 * math.pi, -0.375 * math.pi)
HIGH = (0.2 * math.pi + math.pi / 12, -0.35 * math.pi, -0.125 * math.pi)
"""Of roll, pitch and yaw at the start."""
FORMULA = "always[0,15] altitude > 0"

GRAVITY = 32.17
"""ft/s^2."""
AREA, SPAN, CHORD = 300.0, 30.0, 11.32
"""Of the wing, in ft^2 and ft."""
PER_MASS = 1.57e-3
"""1/slug."""
ENGINE = 160.0
"""Angular momentum, slug ft^2/s."""
INERTIA = (-0.770, 0.02755, 1.055e-4, 1.642e-6, 0.9604, 1.759e-2, 1.792e-5, -0.7336, 1.587e-5)
"""c1 to c9 of Stevens and Lewis, for the centre of gravity at 0.35 of the chord."""
SENSOR = 15.0
"""From the centre of gravity forward to the accelerometers, ft."""

TRIM_ATTACK, TRIM_ELEVATOR, TRIM_THROTTLE = 0.0389, -0.7496, 0.1395
"""Of the linear model of the inner loop: rad, degrees, share."""
LONGITUDINAL = (-156.8801506723475, -31.037008068526642, -38.72983346216317)
"""Gains from attack, pitch rate and integrated load to the elevator."""
TO_AILERON = (37.84483, -25.40956, -6.82876, -332.88343, -17.15997)
TO_RUDDER = (-23.91233, 5.69968, -21.63431, 64.49490, -88.36203)
"""Gains from sideslip, roll rate, yaw rate, integrated roll rate and integrated side load."""
ELEVATOR_LIMIT, AILERON_LIMIT, RUDDER_LIMIT = 25.0, 21.5, 30.0
"""Degrees."""

LEVEL_ROLL, LOW_ROLL_RATE = math.radians(5.0), math.radians(10.0)
"""Below both, the autopilot stops rolling and pulls."""
PULL = 5.0
"""g."""
SHORTEST_PULL = 2.0
"""s."""
ROLL_GAIN, ROLL_RATE_GAIN = 4.0, 2.0
ROLLING, PULLING, STANDBY = range(3)
TURN = 2.0 * math.pi

State = tuple[float, ...]
"""Speed, attack, sideslip, roll, pitch, yaw, p, q, r, altitude, power, integrals of load, roll rate and side load."""


def limited(value: float, limit: float) -> float:
    """Return the value between -limit and limit."""
    return min(max(value, -limit), limit)


def surfaces(state: State) -> tuple[float, float, float]:
    """Return elevator, aileron and rudder in degrees, which the inner loop demands."""
    _, attack, sideslip, _, _, _, p, q, r, _, _, load, rolled, side = state
    elevator = LONGITUDINAL[0] * (attack - TRIM_ATTACK) + LONGITUDINAL[1] * q + LONGITUDINAL[2] * load
    (a1, a2, a3, a4, a5), (r1, r2, r3, r4, r5) = TO_AILERON, TO_RUDDER
    aileron = a1 * sideslip + a2 * p + a3 * r + a4 * rolled + a5 * side
    rudder = r1 * sideslip + r2 * p + r3 * r + r4 * rolled + r5 * side
    return (
        limited(TRIM_ELEVATOR - elevator, ELEVATOR_LIMIT),
        limited(-aileron, AILERON_LIMIT),
        limited(-rudder, RUDDER_LIMIT),
    )


def demands(state: State, mode: int) -> tuple[float, float]:
    """Return the load in g beyond level flight and the roll rate in rad/s that the autopilot demands."""
    if mode == ROLLING:
        roll, p = state[3], state[6]
        return 0.0, -ROLL_GAIN * (roll - TURN * round(roll / TURN)) - ROLL_RATE_GAIN * p
    return (PULL if mode == PULLING else 0.0), 0.0


def power_rate(power: float) -> float:
    """Return the rate of the power in %/s under the throttle of the autopilot (the table below 50 % of the engine)."""
    lead = 64.94 * TRIM_THROTTLE - power
    return lead * (1.0 if lead <= 25.0 else max(1.9 - 0.036 * lead, 0.1))


def loads(state: State) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the acceleration in ft/s^2 by air and engine, and rolling, pitching and yawing moment over q S.

    The moments of rolling and yawing are over the span too, and that of pitching over the chord.
    """
    speed, attack, sideslip, _, _, _, p, q, r, altitude, power = state[:11]
    elevator, aileron, rudder = surfaces(state)
    degrees = 180.0 / math.pi
    still, moved, damped = coefficients(attack * degrees, sideslip * degrees, elevator)
    aileron, rudder = aileron / 20.0, rudder / 30.0
    half = 0.5 / speed
    pitching, rolling, yawing = CHORD * half * q, SPAN * half * p, SPAN * half * r
    cooling = 1.0 - 0.703e-5 * altitude
    pressure = 0.5 * 2.377e-3 * math.pow(cooling, 4.14) * speed * speed
    mach = speed / math.sqrt(1.4 * 1716.3 * 519.0 * cooling)
    by_air = PER_MASS * pressure * AREA
    along = still[0] + pitching * damped[0]
    aside = -0.02 * sideslip * degrees + 0.021 * aileron + 0.086 * rudder + yawing * damped[1] + rolling * damped[2]
    down = still[1] + pitching * damped[3]
    return (
        (by_air * along + PER_MASS * thrust(power, altitude, mach), by_air * aside, by_air * down),
        (
            pressure
            * AREA
            * SPAN
            * (still[2] + moved[0] * aileron + moved[2] * rudder + yawing * damped[4] + rolling * damped[5]),
            pressure * AREA * CHORD * (still[3] + pitching * damped[6]),
            pressure
            * AREA
            * SPAN
            * (still[4] + moved[1] * aileron + moved[3] * rudder + yawing * damped[7] + rolling * damped[8]),
        ),
    )


def rates(state: State, mode: int) -> State:
    """Return the derivative of the state."""
    speed, attack, sideslip, roll, pitch, _, p, q, r, _, power = state[:11]
    (ax, ay, az), (rolling, pitching, yawing) = loads(state)
    sine, cosine = math.sin(pitch), math.cos(pitch)
    sine_roll, cosine_roll = math.sin(roll), math.cos(roll)
    sine_attack, cosine_attack, cosine_side = math.sin(attack), math.cos(attack), math.cos(sideslip)
    u, v, w = speed * cosine_attack * cosine_side, speed * math.sin(sideslip), speed * sine_attack * cosine_side
    du = r * v - q * w - GRAVITY * sine + ax
    dv = p * w - r * u + GRAVITY * cosine * sine_roll + ay
    dw = q * u - p * v + GRAVITY * cosine * cosine_roll + az
    faster = (u * du + v * dv + w * dw) / speed
    plane = u * u + w * w
    turning = q * sine_roll + r * cosine_roll
    c1, c2, c3, c4, c5, c6, c7, c8, c9 = INERTIA
    dp = (c2 * p + c1 * r + c4 * ENGINE) * q + c3 * rolling + c4 * yawing
    dq = (c5 * p - c7 * ENGINE) * r + c6 * (r * r - p * p) + c7 * pitching
    dr = (c8 * p - c2 * r + c9 * ENGINE) * q + c4 * rolling + c9 * yawing
    load, roll_rate = demands(state, mode)
    return (
        faster,
        (u * dw - w * du) / plane,
        (speed * dv - v * faster) * cosine_side / plane,
        p + sine / cosine * turning,
        q * cosine_roll - r * sine_roll,
        turning / cosine,
        dp,
        dq,
        dr,
        u * sine - v * sine_roll * cosine - w * cosine_roll * cosine,
        power_rate(power),
        -(az - SENSOR * dq) / GRAVITY - 1.0 - load,
        p * cosine_attack + r * sine_attack - roll_rate,
        (ay + SENSOR * dr) / GRAVITY + r,
    )


def next_mode(mode: int, state: State, pulled: float) -> int:
    """Return the mode of the autopilot after `pulled` seconds of pulling."""
    _, attack, _, roll, pitch, _, p = state[:7]
    if mode == ROLLING and abs(roll - TURN * round(roll / TURN)) < LEVEL_ROLL and abs(p) < LOW_ROLL_RATE:
        return PULLING
    climb = pitch - attack
    if mode == PULLING and climb - TURN * round(climb / TURN) > 0.0 and pulled >= SHORTEST_PULL:
        return STANDBY
    return mode


def advance(state: State, mode: int, step: float) -> State:
    """Return the state one step of RK4 later."""

    def moved(by: float, along: State) -> State:
        return tuple([x + by * k for x, k in zip(state, along, strict=True)])

    k1 = rates(state, mode)
    k2 = rates(moved(step / 2, k1), mode)
    k3 = rates(moved(step / 2, k2), mode)
    k4 = rates(moved(step, k3), mode)
    return tuple([x + step / 6 * (a + 2 * (b + c) + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)])


def simulate(point: Floats, *, altitude: float, end: float = END) -> Rollout:
    """Simulate from roll, pitch and yaw in rad at an altitude in ft."""
    roll, pitch, yaw = point.tolist()
    state: State = (SPEED, ATTACK, 0.0, roll, pitch, yaw, 0.0, 0.0, 0.0, altitude, POWER, 0.0, 0.0, 0.0)
    times = steps(end, STEP)
    columns = np.empty((len(times), 10))
    modes = np.empty(len(times))
    mode, pulled = ROLLING, 0.0
    for row in range(len(times)):
        mode = next_mode(mode, state, pulled)
        columns[row], modes[row] = state[:10], mode
        pulled += STEP * (mode == PULLING)
        state = advance(state, mode, STEP)
    names = ("speed", "attack", "sideslip", "roll", "pitch", "yaw", "p", "q", "r", "altitude")
    return times, dict(zip(names, columns.T, strict=True)) | {"mode": modes}


BENCHMARKS = tuple(
    Benchmark(name, 1, LOW, HIGH, FORMULA, partial(simulate, altitude=altitude))
    for name, altitude in (("F16", 2338.0), ("F16 from 4040 ft", 4040.0))
)

"""The automatic transmission of the competition (AT): an engine, a torque converter, four gears and their shift logic.

[HAF] B. Hoxha, H. Abbas, G. Fainekos: Benchmarks for temporal logic requirements for automotive systems. ARCH 2014.
The model is sldemo_autotrans of MathWorks with the brake as a second input; tables and constants are the published
ones of the model `Autotrans_shift` of the competition, requirements those of the ARCH-COMP reports 2021 to 2024.

| symbol | name     | meaning                            | unit          |
|--------|----------|------------------------------------|---------------|
| N      | `rpm`    | speed of the engine, 600 to 6000   | 1/min         |
| w      | `wheel`  | speed of the wheels                | 1/min         |
| v      | `speed`  | speed of the vehicle, 2 pi w / 88  | mph           |
| s      | `slip`   | speed ratio of the converter       |               |
| g      | `ratio`  | ratio of the gear                  |               |
| T      | `engine` | torque of the engine, a table      | ft lb         |
| K, r   |          | capacity and torque ratio of the converter, tables of s |

dN/dt = (T(throttle, N) - (N / K(s))^2) / 0.02199, s = 3.23 g w / N
dw/dt = (3.23 g r(s) (N / K(s))^2 - (40 + 0.02 v^2 + brake) sign(v)) / 12.094
The shift logic runs every 0.04 s: a gear changes when v has been beyond its threshold for two of these.

Deviation: the fixed step of 0.01 s is one of Runge and Kutta of order 4 instead of 5, with the inputs of its begin.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from perfbound.orchestrator.mathematics.stl.horizon import horizon
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.arithmetic import Arithmetic, Number, arithmetic
from tests.studies.falsification.models.inputs import held, linear, one, steps

STEP = 0.01
SHIFTING = 4
"""Steps from one decision of the shift logic to the next."""
WAIT = 2
"""Decisions for which the speed has to be beyond the threshold."""
MPH = 2 * np.pi * 60 / 5280
"""Per 1/min of a wheel with a radius of 1 ft."""
FINAL_DRIVE, GEARS = 3.23, (2.393, 1.450, 1.000, 0.677)
PER_ENGINE_INERTIA, PER_VEHICLE_INERTIA = 45.472138452209627, 0.082684618362373577

# The tables; each is linear between its points and beyond them.
SLIPS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, *(0.8 + 0.01 * k for k in range(11)), 0.92, 0.94)
CAPACITIES = (
    *(137.4652089938063, 137.06501915685197, 135.86444964598905, 135.66435472751189, 137.56525645304487),
    *(140.36658531172509, 145.26891081441539, 152.87251771654735, 162.97731109964374, 164.2779280697452),
    *(166.17882979527823, 167.97968406157264, 170.08068070558275, 172.78196210502438, 175.38319604522741),
    *(179.58518933324765, 183.58708770279083, 189.89007763482121, 197.69377945543027, 215.90241703685155),
    244.51599037908485,
)
TORQUE_RATIOS = (
    *(2.232, 2.075, 1.975, 1.846, 1.72, 1.564, 1.409, 1.254, 1.096, 1.08, 1.061, 1.043, 1.028, 1.012, 1.002),
    *(1.002, 1.001, 0.998, 0.999, 1.001, 1.002),
)
THROTTLES = (0, 20, 30, 40, 50, 60, 70, 80, 90, 100)
RPMS = (800, 1200, 1600, 2000, 2400, 2800, 3200, 3600, 4000, 4400, 4800)
TORQUES = (
    (-40, -44, -49, -53, -57, -61, -65, -70, -74, -78, -82),
    (215, 117, 85, 66, 44, 29, 10, -2, -13, -22, -32),
    (245, 208, 178, 148, 122, 104, 85, 66, 48, 33, 18),
    (264, 260, 241, 219, 193, 167, 152, 133, 119, 96, 85),
    (264, 279, 282, 275, 260, 238, 223, 208, 189, 171, 152),
    (267, 290, 293, 297, 290, 275, 260, 256, 234, 212, 193),
    (267, 297, 305, 305, 305, 301, 293, 282, 267, 249, 226),
    (267, 301, 308, 312, 319, 323, 319, 316, 297, 279, 253),
    (267, 301, 312, 319, 327, 327, 327, 327, 312, 293, 267),
    (267, 301, 312, 319, 327, 334, 334, 334, 319, 305, 275),
)
"""Per throttle and engine speed, in ft lb."""
NEVER = 1e6
UP_THROTTLES, UP_SPEEDS = (
    (0, 25, 35, 50, 90, 100),
    ((10, 10, 15, 23, 40, 40), (30, 30, 30, 41, 70, 70), (50, 50, 50, 60, 100, 100), (NEVER,) * 6),
)
DOWN_THROTTLES, DOWN_SPEEDS = (
    (0, 5, 40, 50, 90, 100),
    ((0,) * 6, (5, 5, 5, 5, 30, 30), (20, 20, 25, 30, 50, 50), (35, 35, 40, 50, 80, 80)),
)
"""Speeds in mph at which a gear is left, per gear and throttle."""

SLIP_PIECE, THROTTLE_PIECE, RPM_PIECE, SHIFT_PIECE = 0.01, 10.0, 400.0, 5.0
"""Every table has its points at multiples of these, so that a piece is found by a division."""


def pieces(points: Sequence[float], values: Sequence[float], width: float) -> tuple[Floats, Floats]:
    """Return a_i, b_i: on the piece i, from the first point + i width, the table is a_i + b_i x.

    >>> [each.tolist() for each in pieces([0, 2, 3], [0, 2, 7], 1)]
    [[0.0, 0.0, -8.0], [1.0, 1.0, 5.0]]
    """
    begins = points[0] + width * np.arange(round((points[-1] - points[0]) / width))
    segment = np.searchsorted(points, begins + width / 2) - 1
    x, y = np.array(points, dtype=np.float64), np.array(values, dtype=np.float64)
    slopes = np.diff(y) / np.diff(x)
    return (y[:-1] - slopes * x[:-1])[segment], slopes[segment]


class Tables(NamedTuple):
    """Coefficients of the pieces of every table."""

    capacity: tuple[Number, Number]
    torque_ratio: tuple[Number, Number]
    torque: tuple[Number, Number, Number, Number]
    """1, throttle, rpm, throttle * rpm; index 10 * piece of the throttle + piece of the engine speed."""
    up: tuple[Number, Number]
    down: tuple[Number, Number]
    """Index 20 * (gear - 1) + piece of the throttle."""
    gear: Number
    """Ratio with the final drive."""


@cache
def _tables(rollouts_as_arrays: bool) -> Tables:
    """Return the tables, as lists for floats or as arrays."""
    table = arithmetic(2 if rollouts_as_arrays else 1).table
    over_rpm = [pieces(RPMS, row, RPM_PIECE) for row in TORQUES]
    constants, slopes = (
        [pieces(THROTTLES, column, THROTTLE_PIECE) for column in np.array([row[k] for row in over_rpm]).T]
        for k in (0, 1)
    )
    torque = (np.array([each[k] for each in of]).T.ravel() for of in (constants, slopes) for k in (0, 1))
    alone, throttle, rpm, both = (table(each) for each in torque)
    up, down = (
        tuple(table(np.concatenate([pieces(throttles, row, SHIFT_PIECE)[k] for row in speeds])) for k in (0, 1))
        for throttles, speeds in ((UP_THROTTLES, UP_SPEEDS), (DOWN_THROTTLES, DOWN_SPEEDS))
    )
    capacity, ratio = (
        tuple(table(each) for each in pieces(SLIPS, values, SLIP_PIECE)) for values in (CAPACITIES, TORQUE_RATIOS)
    )
    gear = table(FINAL_DRIVE * np.array(GEARS))
    return Tables(capacity, ratio, (alone, throttle, rpm, both), up, down, gear)


class Drivetrain:
    """The state of one rollout, or of many at once; a step moves it."""

    def __init__(self, numbers: Arithmetic, tables: Tables) -> None:
        self._numbers, self._tables = numbers, tables
        self.rpm, self.wheel, self.gear = numbers.constant(1000.0), numbers.constant(0.0), numbers.constant(1.0)
        self._beyond, self._decisions = numbers.constant(0.0), numbers.constant(0.0)
        # `_beyond`: 1 above the upper threshold, -1 below the lower one, for `_decisions` decisions; else 0.

    @property
    def speed(self) -> Number:
        """In mph."""
        return MPH * self.wheel

    def decide(self, throttle: Number) -> None:
        """Run the shift logic."""
        choose, tables = self._numbers.choose, self._tables
        piece = 20 * self._numbers.piece(self.gear - 1.0, 3) + self._numbers.piece(throttle / SHIFT_PIECE, 19)
        up = tables.up[0][piece] + tables.up[1][piece] * throttle
        down = tables.down[0][piece] + tables.down[1][piece] * throttle
        speed, self._decisions = self.speed, self._decisions + 1.0
        above, below = self._beyond > 0, self._beyond < 0
        shifts = self._decisions >= WAIT
        shifts_up, shifts_down = above & shifts & (speed >= up), below & shifts & (speed <= down)
        starts = choose(speed > up, 1.0, choose(speed < down, -1.0, 0.0))
        stays = (above & (speed >= up)) | (below & (speed <= down))
        steady = self._beyond == 0
        self._decisions = choose(steady, 0.0, self._decisions)
        self._beyond = choose(steady, starts, choose(shifts_up | shifts_down, 0.0, choose(stays, self._beyond, 0.0)))
        changed = choose(shifts_up, self.gear + 1.0, choose(shifts_down, self.gear - 1.0, self.gear))
        self.gear = choose(changed < 1.0, 1.0, changed)

    def move(self, throttle: Number, brake: Number) -> None:
        """Integrate over one step."""
        choose, h = self._numbers.choose, STEP
        rates = self._rates(throttle, brake)
        rpm, wheel = self.rpm, self.wheel
        n1, w1 = rates(rpm, wheel)
        n2, w2 = rates(rpm + h / 2 * n1, wheel + h / 2 * w1)
        n3, w3 = rates(rpm + h / 2 * n2, wheel + h / 2 * w2)
        n4, w4 = rates(rpm + h * n3, wheel + h * w3)
        rpm = rpm + h / 6 * (n1 + 2 * (n2 + n3) + n4)
        self.rpm = choose(rpm < 600.0, 600.0, choose(rpm > 6000.0, 6000.0, rpm))
        self.wheel = wheel + h / 6 * (w1 + 2 * (w2 + w3) + w4)

    def _rates(self, throttle: Number, brake: Number) -> Callable[[Number, Number], tuple[Number, Number]]:
        """Return (N, w) -> (dN/dt, dw/dt) with these inputs and the present gear."""
        piece, choose, tables = self._numbers.piece, self._numbers.choose, self._tables
        ratio = tables.gear[piece(self.gear - 1.0, 3)]
        row = 10 * piece(throttle / THROTTLE_PIECE, 9)
        (k0, k1), (r0, r1), (e0, e1, e2, e3) = tables.capacity, tables.torque_ratio, tables.torque
        load = 40.0 + brake

        def rates(rpm: Number, wheel: Number) -> tuple[Number, Number]:
            slip = ratio * wheel / rpm
            i = piece(slip / SLIP_PIECE, 93)
            j = row + piece(rpm / RPM_PIECE - 2.0, 9)
            impeller = rpm / (k0[i] + k1[i] * slip)
            impeller = impeller * impeller
            engine = e0[j] + e1[j] * throttle + (e2[j] + e3[j] * throttle) * rpm
            speed = MPH * wheel
            road = (load + 0.02 * speed * speed) * choose(speed > 0.0, 1.0, choose(speed < 0.0, -1.0, 0.0))
            return (
                PER_ENGINE_INERTIA * (engine - impeller),
                PER_VEHICLE_INERTIA * (ratio * impeller * (r0[i] + r1[i] * slip) - road),
            )

        return rates


def drive(throttle: Floats, brake: Floats) -> Rollout:
    """Return the rollouts with these inputs (R, T), one value for each step of 0.01 s: columns (R, T)."""
    numbers = arithmetic(len(throttle))
    car = Drivetrain(numbers, _tables(len(throttle) > 1))
    speed, rpm, gear = [], [], []
    for step, inputs in enumerate(zip(numbers.series(throttle.T), numbers.series(brake.T), strict=True)):
        if step and step % SHIFTING == 0:
            car.decide(inputs[0])
        speed.append(car.speed)
        rpm.append(car.rpm)
        gear.append(car.gear)
        car.move(*inputs)
    times = steps((throttle.shape[1] - 1) * STEP, STEP)
    return times, {"speed": numbers.recorded(speed), "rpm": numbers.recorded(rpm), "gear": numbers.recorded(gear)}


THROTTLE, BRAKE = (0.0, 100.0), (0.0, 325.0)
EVERY = 5.0
"""Instance 2: seconds from one discontinuity of the inputs to the next. Instance 1: from one knot of the throttle to
the next, and half of the time from one of the brake to the next; both inputs are linear between their knots."""


def simulate_each(points: Floats, duration: float, instance: int) -> Rollout:
    """Return the rollouts of points (R, p): the values or knots of the throttle, then those of the brake."""
    times = steps(duration, STEP)
    throttle, brake = np.split(points, [_counts(duration, instance)[0]], axis=1)
    if instance == 2:
        return drive(held(throttle, EVERY, times), held(brake, EVERY, times))
    return drive(linear(throttle, duration, times), linear(brake, duration, times))


def _counts(duration: float, instance: int) -> tuple[int, int]:
    """Return the number of parameters of the throttle and of the brake."""
    if instance == 2:
        return math.ceil(duration / EVERY), math.ceil(duration / EVERY)
    return math.floor(duration / EVERY) + 1, math.floor(duration / (2 * EVERY)) + 1


def _benchmark(name: str, formula: str, instance: int) -> Benchmark:
    duration = horizon(parse_formula(formula))
    throttle, brake = _counts(duration, instance)
    low, high = ((THROTTLE[end],) * throttle + (BRAKE[end],) * brake for end in (0, 1))
    each = partial(simulate_each, duration=duration, instance=instance)
    return Benchmark(name, instance, low, high, formula, partial(one, each), each, (throttle, brake))


def _stays_in(gear: int) -> str:
    """Return AT5: once the gear is engaged it remains so for 2.5 s."""
    shifted = f"not gear == {gear} and eventually[0.001,0.1] gear == {gear}"
    return f"always[0,30] ({shifted} implies eventually[0.001,0.1] always[0,2.5] gear == {gear})"


def _slow_engine(until: int, speed: int) -> str:
    """Return AT6: an engine below 3000 rpm for 30 s means a speed below `speed` mph for `until` s."""
    return f"((always[0,30] (rpm < 3000)) implies (always[0,{until}] (speed < {speed})))"


AT6 = {"AT6a": _slow_engine(4, 35), "AT6b": _slow_engine(8, 50), "AT6c": _slow_engine(20, 65)}
REQUIREMENTS = {
    "AT1": "always[0,20] (speed < 120)",
    "AT2": "always[0,10] (rpm < 4750)",
    **{f"AT5{gear}": _stays_in(gear) for gear in (1, 2, 3, 4)},
    **AT6,
    "AT6abc": " and ".join(AT6.values()),
}
BENCHMARKS = tuple(_benchmark(name, each, instance) for name, each in REQUIREMENTS.items() for instance in (1, 2))

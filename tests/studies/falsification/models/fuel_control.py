"""The control of the air-fuel ratio of a petrol engine: AFC of the competition.

Model 1 of Jin, Deshmukh, Kapinski, Ueda and Butts, "Powertrain Control Verification Benchmark" (HSCC 2014): throttle
and manifold (after Crossley and Cook, 1991), wall wetting and exhaust delay with their tables (after Guzzella and
Onder), and the controller of 10 ms with its three modes. Own code. Left out: failures and tolerances of the sensors,
which the competition has at their neutral values. The manifold is solved by implicit steps, the exhaust by exact steps
with the ratio of the middle of each; the competition has a variable step.

Uniform random search with 100 simulations found a failure of AFC27 in 6 of 50 runs on the model of the competition,
with a robustness of -0.0004 at the least (FalStar's results of 2018); here 2 of 2,000 random inputs fail, with the
same robustness.

There is no instance 1. Instance 2: 10 angles of the pedal, each held for 5 s, the last one on to 55 s, which AFC27
reads; the last parameter is the speed of the engine, which is constant.
"""

import itertools
import math
from typing import TypeVar

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.inputs import held, steps

PERIOD = 0.01
"""Of the controller, s."""
END = 55.0
SEGMENTS = 10
LAST_CHANGE = 50.0
SPEEDS = (900.0, 1100.0)
"""Of the engine, in revolutions per minute."""
NORMAL_PEDAL = (0.0, 61.2)
POWER_PEDAL = (61.2, 81.2)
"""Angles of the pedal, in degrees."""

IDLE = 8.8
"""Angle of the throttle under no pedal, degrees."""
THROTTLE_LAG = 0.1
"""s."""
PUMPING_GAIN = 0.9
"""Of the true flow over the one that the controller expects."""
MANIFOLD = 0.41328
"""R T / V, bar/g."""
FIRST_PRESSURE = 0.982
FIRST_PUDDLE = 0.0112
CALM = 0.01
"""Relative change of the angle in a period below which one step of the manifold is enough."""
SHORT = 8
"""Steps of the manifold in a period in which the throttle moves."""
PARTS = tuple(
    math.expm1(-k * PERIOD / SHORT / THROTTLE_LAG) / math.expm1(-PERIOD / THROTTLE_LAG) for k in range(1, SHORT + 1)
)
"""Shares of its movement that the lag has made after each of them."""
EXHAUST_LAG = 0.1
SENSOR_LAG = 0.02
STOICHIOMETRIC, RICH = 14.7, 12.5
FIRST_FUEL = 0.1726
FUEL_LIMITS = (0.13, 1.66)
"""g/s."""
PROPORTIONAL, INTEGRAL = 0.04, 0.14
NORMAL_AFTER = 10.0
POWER_ON, POWER_OFF = 70.0, 50.0
"""Angles of the throttle, degrees."""

# Rows by speed of the engine (rpm), columns by charge of a cylinder (g).
WALL_SPEEDS = (1000.0, 1500.0, 2000.0, 2500.0, 3000.0)
WALL_CHARGES = (0.1, 0.2, 0.3, 0.4)
VAPOUR = (
    (0.8, 0.7, 0.66, 0.6),
    (0.7, 0.66, 0.66, 0.6),
    (0.7, 0.65, 0.63, 0.6),
    (0.8, 0.73, 0.66, 0.6),
    (0.9, 0.85, 0.8, 0.7),
)
"""Share of the fuel that is not deposited on the wall."""
EVAPORATION = (
    (0.4, 0.22, 0.2, 0.35),
    (0.3, 0.22, 0.22, 0.3),
    (0.35, 0.4, 0.5, 0.45),
    (0.3, 0.35, 0.4, 0.5),
    (0.2, 0.5, 0.35, 0.4),
)
"""Time constant of the puddle, s."""
DELAY_SPEEDS = (800.0, 1000.0, 1500.0, 2000.0, 3000.0)
DELAY_CHARGES = (0.05, 0.15, 0.2, 0.25)
DELAY = (
    (0.8, 0.4, 0.3, 0.25),
    (0.6, 0.3, 0.25, 0.2),
    (0.4, 0.2, 0.2, 0.2),
    (0.3, 0.2, 0.2, 0.2),
    (0.2, 0.2, 0.2, 0.2),
)
"""From the cylinder to the sensor, s."""

Values = TypeVar("Values", float, Floats)
Table = tuple[tuple[float, ...], ...]


def looked_up(
    table: Table, speeds: tuple[float, ...], charges: tuple[float, ...], speed: float, charge: Floats
) -> Floats:
    """Return a table's value at one speed: linear, extrapolated in the speed, held at the ends of the charge."""
    row = min(max(int(np.searchsorted(speeds, speed, side="right")) - 1, 0), len(speeds) - 2)
    share = (speed - speeds[row]) / (speeds[row + 1] - speeds[row])
    return np.interp(charge, charges, (1 - share) * np.array(table[row]) + share * np.array(table[row + 1]))


def throttle(pedal: Floats) -> Floats:
    """Return the angle of the throttle in degrees at each period: a lag of first order behind the pedal."""
    decay = math.exp(-PERIOD / THROTTLE_LAG)
    lagged = np.empty_like(pedal)
    now = 0.0
    for k, angle in enumerate(pedal.tolist()):
        lagged[k] = now
        now = angle + (now - angle) * decay
    return np.clip(IDLE + lagged, 0.0, 90.0)


def opening(angle: Values) -> Values:
    """Return the flow of air in g/s that a throttle lets through at the speed of sound."""
    return 2.821 + angle * (-0.05231 + angle * (0.10299 - angle * 0.00063))


def manifold(angle: Floats, omega: float) -> Floats:
    """Return the pressure of the manifold in bar at each period, under ambient pressure 1 bar.

    The flow is 2 sqrt(p - p^2) of the opening, or all of it where p < 0.5. Its slope is infinite at p = 1, where a wide
    open throttle settles, so the method is implicit (BDF2), with short steps while the throttle moves.
    """
    linear, square, constant = (PUMPING_GAIN * c for c in (0.08979 * omega + 0.0001 * omega**2, 0.0337 * omega, 0.366))
    root = math.sqrt(1.0 - FIRST_PRESSURE)

    def solved(known: float, h: float, through: float) -> float:
        """Solve p = known + h F(p) by Newton's method for the root of 1 - p, in which the flow is smooth."""
        nonlocal root
        for _ in range(5):
            new = 1.0 - root * root
            flow, slope = through, 0.0
            if new > 0.5:
                cosine = math.sqrt(new)
                flow, slope = through * 2.0 * root * cosine, through * 2.0 * (cosine - root * root / cosine)
            excess = new - known - h * (flow + constant - linear * new + square * new * new)
            gradient = -2.0 * root - h * (slope + (linear - 2.0 * square * new) * 2.0 * root)
            change = excess / gradient if gradient else 0.0
            root = max(root - change, 0.0)
            if abs(change) < 1e-8:
                break
        return 1.0 - root * root

    def advanced(known: float, earlier: float | None, h: float, through: float) -> float:
        """Return the pressure one step of BDF2 later, or of implicit Euler where no equal step went before."""
        if earlier is None:
            return solved(known, h, through)
        return solved((4.0 * known - earlier) / 3.0, h * 2.0 / 3.0, through)

    pressures = [FIRST_PRESSURE]
    now = FIRST_PRESSURE
    before: float | None = None
    calm = True
    step = PERIOD * MANIFOLD
    for last, new in itertools.pairwise(angle.tolist()):
        if calm != (abs(new - last) <= CALM * last):
            calm, before = not calm, None
        if calm:
            now, before = advanced(now, before, step, opening(new)), now
        else:
            for share in PARTS:
                now, before = advanced(now, before, step / SHORT, opening(last + share * (new - last))), now
        pressures.append(now)
    return np.array(pressures)


def pumped(pressure: Floats, omega: float) -> Floats:
    """Return the flow of air into the cylinders in g/s."""
    expected = -0.366 + pressure * (0.08979 * omega - 0.0337 * omega * pressure + 0.0001 * omega**2)
    return PUMPING_GAIN * np.asarray(expected)


def emission_times(times: Floats, delay: Floats) -> Floats:
    """Return when the gas that arrives at each time was emitted: a pipe with the flow 1/delay; -1 before the start."""
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * PERIOD * (1 / delay[1:] + 1 / delay[:-1]))])
    return np.where(travelled < 1.0, -1.0, np.interp(travelled - 1.0, travelled, times))


def modes(angle: Floats, times: Floats) -> tuple[list[bool], list[float]]:
    """Return whether the controller ignores the sensor, and the ratio that it demands, at each period."""
    normal = times >= NORMAL_AFTER - PERIOD / 2
    power = np.zeros(len(angle), dtype=bool)
    on = False
    for k, now in enumerate(angle.tolist()):
        on = power[k] = now >= (POWER_OFF if on else POWER_ON)
    return (~normal | power).tolist(), np.where(normal & power, RICH, STOICHIOMETRIC).tolist()


def controlled(air: Floats, flow: Floats, angle: Floats, speed: float, times: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the measured ratio, the demanded one, and whether the loop is open, at each period.

    `air` is the flow into the cylinders and `flow` the one through the throttle, both in g/s.
    """
    omega = speed * math.pi / 30.0
    charge = math.pi * air / omega
    vapour = looked_up(VAPOUR, WALL_SPEEDS, WALL_CHARGES, speed, charge).tolist()
    evaporation = looked_up(EVAPORATION, WALL_SPEEDS, WALL_CHARGES, speed, charge)
    kept = np.exp(-PERIOD / evaporation).tolist()
    delay = looked_up(DELAY, DELAY_SPEEDS, DELAY_CHARGES, speed, charge)
    emitted = (emission_times(times, delay) / PERIOD).tolist()
    open_loop, demanded = modes(angle, times)
    to_cylinder = (0.5 * (air + np.append(air[1:], air[-1:]))).tolist()
    linear, square = 0.08979 * omega + 0.0001 * omega**2, 0.0337 * omega
    # Exact steps of two lags in a row under a constant input.
    slow, fast = math.exp(-PERIOD / EXHAUST_LAG), math.exp(-PERIOD / SENSOR_LAG)
    across = EXHAUST_LAG / (EXHAUST_LAG - SENSOR_LAG) * (slow - fast)
    estimate, integral, puddle = FIRST_PRESSURE, 0.0, FIRST_PUDDLE
    mixed = measured = STOICHIOMETRIC
    fuel = FIRST_FUEL
    ratios: list[float] = []
    seen = np.empty(len(times))
    for k, (through, tau) in enumerate(zip(flow.tolist(), evaporation.tolist(), strict=True)):
        seen[k] = measured
        if k:
            expected = -0.366 + estimate * (linear - square * estimate)
            estimate += PERIOD * MANIFOLD * (through - expected)
            fuel = expected / demanded[k]
            if not open_loop[k]:
                error = measured - demanded[k]
                integral += PERIOD * INTEGRAL * error
                fuel *= max(1.0 + PROPORTIONAL * error + integral, 0.0)
            fuel = min(max(fuel, FUEL_LIMITS[0]), FUEL_LIMITS[1])
        settled = (1.0 - vapour[k]) * fuel * tau
        later = settled + (puddle - settled) * kept[k]
        ratios.append(to_cylinder[k] / (vapour[k] * fuel + 0.5 * (puddle + later) / tau))
        puddle = later
        arriving = STOICHIOMETRIC
        if emitted[k] >= 0.0:
            # Ratio k is that of the middle of period k.
            place = max(emitted[k], 0.0)
            row = int(place)
            arriving = ratios[row] + (place - row) * (ratios[row + 1] - ratios[row])
        measured = arriving + (measured - arriving) * fast + (mixed - arriving) * across
        mixed = arriving + (mixed - arriving) * slow
    return seen, np.array(demanded), np.array(open_loop, dtype=float)


def rollout(pedal: Floats, speed: float, times: Floats) -> Rollout:
    """Simulate under angles of the pedal in degrees at each period and a constant speed in rpm."""
    omega = speed * math.pi / 30.0
    angle = throttle(pedal)
    pressure = manifold(angle, omega)
    area = opening(angle)
    flow = np.where(pressure > 0.5, area * 2.0 * np.sqrt(np.maximum(pressure - pressure**2, 0.0)), area)
    measured, demanded, open_loop = controlled(pumped(pressure, omega), flow, angle, speed, times)
    return times, {
        "pedal": pedal,
        "speed": np.full_like(times, speed),
        "ratio": measured,
        "mu": (measured - demanded) / demanded,
        "open_loop": open_loop,
        "throttle": angle,
        "pressure": pressure,
    }


def simulate(point: Floats) -> Rollout:
    """Simulate the angles of the pedal and the speed of the engine that `point` has."""
    times = steps(END, PERIOD)
    return rollout(held(point[:-1], LAST_CHANGE / (len(point) - 1), times), float(point[-1]), times)


RISE = "(pedal < 8.8 and eventually[0,0.05] pedal > 40)"
FALL = "(pedal > 40 and eventually[0,0.05] pedal < 8.8)"
REQUIREMENTS = (
    ("AFC27", NORMAL_PEDAL, f"always[11,50] ({RISE} or {FALL} implies always[1,5] abs(mu) < 0.008)"),
    ("AFC29", NORMAL_PEDAL, "always[11,50] abs(mu) < 0.007"),
    ("AFC33", POWER_PEDAL, "always[11,50] abs(mu) < 0.007"),
)
BENCHMARKS = tuple(
    Benchmark(
        name,
        2,
        (*[pedal[0]] * SEGMENTS, SPEEDS[0]),
        (*[pedal[1]] * SEGMENTS, SPEEDS[1]),
        formula,
        simulate,
        inputs=(SEGMENTS,),
    )
    for name, pedal, formula in REQUIREMENTS
)

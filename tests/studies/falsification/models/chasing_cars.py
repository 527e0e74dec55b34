"""The chasing cars of the competition (CC): five cars in a row, of which the inputs drive the first.

[HLS] J. Hu, J. Lygeros, S. Sastry: Towards a theory of stochastic hybrid systems. HSCC 2000. The model is `cars` of
the competition, requirements are those of the ARCH-COMP reports 2021 to 2024.

| symbol | name             | meaning                                                   | unit |
|--------|------------------|-----------------------------------------------------------|------|
| y      | `place`          | place of a car; the first one drives to ever lower places | m    |
| v      | `speed`          | its speed                                                 | m/s  |
| d      | `gap`            | y minus that of the car ahead                             | m    |
| h      | `STEP`           | step                                                      | s    |

The first car:     v' = -throttle - brake v,  y' = v.
Each follower:     keeping: v' = 0, y' = v     chasing: v' = 1, y' = -v     braking: v' = -v, y' = -v
From one to the other: keeping to chasing at d >= 15, keeping to braking at d <= 5, chasing to keeping at d <= 10,
braking to chasing at d >= 20. A car that keeps its distance moves backwards: so it is in the model of the competition.

The first car moves exactly, its inputs being constant over a step. A follower moves exactly with each of its modes;
the moment in a step at which it changes its mode is that of a gap that is linear between both ends of the step.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.arithmetic import Arithmetic, Number, arithmetic
from tests.studies.falsification.models.inputs import held, linear, one, steps

STEP = 0.025
RECORDED = 2
"""Steps from one sample to the next."""
DURATION = 100.0
STARTS = (0.0, 10.0, 20.0, 30.0, 40.0)

# Of each mode, where a mode is an index: keeping, chasing, braking.
KEEPING, CHASING, BRAKING = 0, 1, 2
DIRECTION = np.array([1.0, -1.0, 0.0])
ACCELERATION = np.array([0.0, 1.0, 0.0])
DRAG = np.array([0.0, 0.0, 1.0])
NEAR, FAR = np.array([5.0, 10.0, -math.inf]), np.array([15.0, math.inf, 20.0])
"""Gaps at which a mode ends."""
WHEN_NEAR, WHEN_FAR = np.array([BRAKING, KEEPING, BRAKING]), np.array([CHASING, CHASING, CHASING])


def leader(throttle: Floats, brake: Floats) -> Floats:
    """Return the places (T, R) of the first car under inputs (R, T) that are constant over a step."""
    small = brake < 1e-5
    b = np.where(small, 1.0, brake)
    # Integrals over a step of exp(-b s), and of the integral of that.
    once = np.where(small, STEP - brake * STEP**2 / 2, -np.expm1(-b * STEP) / b)
    twice = np.where(small, STEP**2 / 2 - brake * STEP**3 / 6, (STEP - once) / b)
    kept = 1.0 - brake * once
    places, speed = np.zeros(throttle.T.shape), np.zeros(len(throttle))
    for step in range(throttle.shape[1] - 1):
        push = throttle[:, step]
        places[step + 1] = places[step] + once[:, step] * speed - twice[:, step] * push
        speed = kept[:, step] * speed - once[:, step] * push
    return places


def drive(throttle: Floats, brake: Floats) -> Rollout:
    """Return the rollouts with these inputs (R, T), one value for each step: columns (R, samples)."""
    numbers = arithmetic(len(throttle))
    ahead = leader(throttle, brake)
    columns = {"y1": ahead.T[:, ::RECORDED]}
    for car, start in enumerate(STARTS[1:], start=2):
        series = numbers.series(ahead)
        places = _followed(series, numbers.constant(start), len(throttle))
        recorded = numbers.recorded(places)
        columns[f"y{car}"] = recorded[:, ::RECORDED]
        ahead = recorded.T
    return steps(DURATION, RECORDED * STEP), columns


def _followed(ahead: Sequence[Number], place: Number, rollouts: int) -> list[Number]:
    """Return the places of a car, given those of the car ahead."""
    numbers = arithmetic(rollouts)
    choose, moved = numbers.choose, _flow(numbers)
    near, far = numbers.table(NEAR), numbers.table(FAR)
    when_near, when_far = numbers.table(WHEN_NEAR), numbers.table(WHEN_FAR)
    speed, mode = numbers.constant(0.0), numbers.constant(KEEPING)
    places, gap = [place], place - ahead[0]
    for other in ahead[1:]:
        then_place, then_speed = moved(place, speed, mode, STEP)
        then = then_place - other
        too_near, too_far = then <= near[mode], then >= far[mode]
        if numbers.anywhere(too_near | too_far):
            border = choose(too_near, near[mode], choose(too_far, far[mode], then))
            before = STEP * (border - gap) / choose(then == gap, 1.0, then - gap)
            place, speed = moved(place, speed, mode, before)
            mode = choose(too_near, when_near[mode], choose(too_far, when_far[mode], mode))
            place, speed = moved(place, speed, mode, STEP - before)
            gap = place - other
        else:
            place, speed, gap = then_place, then_speed, then
        places.append(place)
    return places


def _flow(numbers: Arithmetic) -> Callable[[Number, Number, Number, Number], tuple[Number, Number]]:
    """Return (y, v, mode, seconds of at most a step) -> (y, v) after these seconds in the mode."""
    direction, acceleration, drag = (numbers.table(each) for each in (DIRECTION, ACCELERATION, DRAG))

    def moved(place: Number, speed: Number, mode: Number, h: Number) -> tuple[Number, Number]:
        # 1 - exp(-h), to 1e-10 of its value.
        braked = drag[mode] * speed * h * (1.0 - h / 2 * (1.0 - h / 3 * (1.0 - h / 4 * (1.0 - h / 5))))
        gained = acceleration[mode] * h
        return place + (direction[mode] * speed - gained / 2) * h - braked, speed + gained - braked

    return moved


EVERY, KNOTS = 5.0, 6
"""Instance 2: seconds from one discontinuity of the inputs to the next. Instance 1: knots of each input, one every
20 s, between which it is linear."""


def simulate_each(points: Floats, instance: int) -> Rollout:
    """Return the rollouts of points (R, p): the values or knots of the throttle, then those of the brake."""
    times = steps(DURATION, STEP)
    throttle, brake = np.split(points, 2, axis=1)
    if instance == 2:
        return drive(held(throttle, EVERY, times), held(brake, EVERY, times))
    return drive(linear(throttle, DURATION, times), linear(brake, DURATION, times))


REQUIREMENTS = {
    "CC1": "always[0,100] (y5 - y4 <= 40)",
    "CC2": "always[0,70] (eventually[0,30] (y5 - y4 >= 15))",
    "CC3": "always[0,80] ((always[0,20] (y2 - y1 <= 20)) or eventually[0,20] (y5 - y4 >= 40))",
    "CC4": "always[0,65] (eventually[0,30] (always[0,5] (y5 - y4 >= 8)))",
    "CC5": "always[0,72] (eventually[0,8] ((always[0,5] (y2 - y1 >= 9)) implies always[5,20] (y5 - y4 >= 9)))",
    "CCx": " and ".join(f"(always[0,50] (y{car + 1} - y{car} > 7.5))" for car in (1, 2, 3, 4)),
}


def _benchmark(name: str, formula: str, instance: int) -> Benchmark:
    knots = KNOTS if instance == 1 else math.ceil(DURATION / EVERY)
    each = partial(simulate_each, instance=instance)
    low, high = ((end,) * 2 * knots for end in (0.0, 1.0))
    return Benchmark(name, instance, low, high, formula, partial(one, each), each, (knots, knots))


BENCHMARKS = tuple(_benchmark(name, each, instance) for name, each in REQUIREMENTS.items() for instance in (1, 2))

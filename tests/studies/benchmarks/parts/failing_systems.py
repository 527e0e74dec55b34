"""The five systems of the falsification benchmark: the robustness of a start as a function on the unit box.

Each fails at few of its starts, at most a few per cent of the box. Where a rollout is random its seed follows from the
start, so that a start has one value, however often it is asked for.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from perfbound.workers.systems.segway import SegwaySystem
from tests.fakes.segway import errors

Floats = NDArray[np.float64]
Robustness = Callable[[tuple[float, ...], int], float]
"""(a start in the units of the system, a seed) -> its robustness; a failure is below 0."""


@dataclass(frozen=True)
class FailingSystem:
    """A system with a rare failure."""

    name: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    robustness: Robustness
    counted: int = 20_000
    """Random starts that the share of failures is measured with."""

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.low)

    def __call__(self, unit: Floats) -> float:
        """Return the robustness at a point of the unit box, shape (p,)."""
        low, high = np.array(self.low), np.array(self.high)
        start = tuple((low + np.clip(unit, 0.0, 1.0) * (high - low)).tolist())
        seed = int.from_bytes(hashlib.sha256(repr(start).encode()).digest()[:6])
        return self.robustness(start, seed)


def share(system: FailingSystem, seed: int = 0) -> float:
    """Return the share of random starts that fail."""
    starts = np.random.default_rng(seed).random((system.counted, system.dimension))
    return sum(system(unit) < 0 for unit in starts) / len(starts)


def cars(start: tuple[float, ...], seed: int) -> float:
    """Return the margin in m of the cars of `deploy/examples/cars`: always (distance >= 2)."""
    gap, speed = start
    t = np.arange(0.0, 8.025, 0.05)
    delay = 0.5 * np.random.default_rng(seed).uniform(0.8, 1.2)
    ahead = np.maximum(speed - 6 * t, 0)
    follower = np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
    return float(np.min(gap + 0.05 * np.cumsum(ahead - follower)) - 2)


def pendulum(start: tuple[float, ...], seed: int) -> float:
    """Return the margin in rad of the pendulum of `deploy/examples/pendulum`: always (abs(angle) <= 0.5)."""
    angle, rate = start
    largest = abs(angle)
    for gust in np.random.default_rng(seed).uniform(-0.5, 0.5, 300).tolist():
        torque = max(-6.0, min(6.0, -25.0 * angle - 7.0 * rate))
        rate += 0.01 * (9.81 * math.sin(angle) + torque + gust)
        angle += 0.01 * rate
        largest = max(largest, abs(angle))
        if largest > 2:  # it has fallen
            break
    return 0.5 - largest


def cartpole(start: tuple[float, ...], seed: int) -> float:
    """Return the margin in m of a pole on a cart under a limited force: always (abs(position) <= 2), and upright.

    The masses, the damping, the gains and the limit are those of `deploy/examples/cartpole`; a point mass of 0.2 kg at
    0.5 m is the pole. Without MuJoCo, and so on every machine.
    """
    position, angle, speed, rate = start
    cart, pole, half, step = 1.0, 0.2, 0.5, 0.01
    largest = abs(position)
    for gust in np.random.default_rng(seed).normal(0.0, 0.1, 300).tolist():
        force = 2.8 * position + 40 * angle + 4.2 * speed + 9.6 * rate
        force = max(-10.0, min(10.0, force)) - 0.1 * speed
        sine, cosine = math.sin(angle), math.cos(angle)
        total = cart + pole
        torque = 9.81 * sine + gust / (pole * half) - cosine * (force + pole * half * rate**2 * sine) / total
        lean = torque / (half * (1 - pole * cosine**2 / total))
        push = (force + pole * half * (rate**2 * sine - lean * cosine)) / total
        speed, rate = speed + step * push, rate + step * lean
        position, angle = position + step * speed, angle + step * rate
        largest = max(largest, abs(position))
        if abs(angle) > math.pi / 2:  # it lies on the cart
            return -1.0
    return max(2.0 - largest, -1.0)


@cache
def _segway() -> SegwaySystem:
    return SegwaySystem()


def segway(start: tuple[float, ...], seed: int) -> float:
    """Return the margin in rad of the Segway with aggressive gains from a noisy start: always (abs(phi) <= 0.86).

    A start is x and y; three seconds contain the largest tilt.
    """
    found = _segway().rollout(
        start,
        variant="true",
        seed=seed,
        horizon=3.0,
        options={"gains": "aggressive"},
        progress=lambda _: None,
        disturbances=errors(seed, variance=0.01),
    )
    return 0.86 - float(np.abs(found.samples[:, found.columns.index("phi")]).max())


def braking(start: tuple[float, ...], seed: int) -> float:
    """Return the margin in m of a vehicle that brakes for a line 100 m ahead: always (distance >= 0).

    A hybrid system: its motors brake with 5 m/s2 and charge the battery; when that is full the friction brakes take
    over, after 0.5 s without any braking. Whether this happens before it stands is a jump of the margin, at the corner
    of a high speed (m/s), a full battery (share) and a slope downhill (share).
    """
    speed, charge, slope = start
    distance, pause, motors = 100.0, 0.0, True
    while speed > 0:
        if motors and charge >= 1:
            motors, pause = False, 0.5
        pause -= 0.01
        brake = 0.0 if not motors and pause > 0 else 5.0
        charge += 0.01 * 2e-4 * brake * speed if motors else 0.0
        speed -= 0.01 * (brake + 9.81 * slope)
        distance -= 0.01 * max(speed, 0.0)
    return distance


SYSTEMS = (
    FailingSystem("cars", (5, 5), (60, 35), cars),
    FailingSystem("pendulum", (-0.4, -0.8), (0.4, 0.8), pendulum),
    FailingSystem("cartpole", (-1, -0.3, -1, -0.8), (1, 0.3, 1, 0.8), cartpole),
    FailingSystem("Segway", (-20, -20), (25, 25), segway, counted=2000),
    FailingSystem("braking", (5, 0, -0.05), (30, 1, 0.05), braking),
)

"""A levitated magnet under a neural controller of our own: NOT the benchmark NN of the competition.

NN has the plant and the requirement below, but the weights of its controller are those of a model of MathWorks, which
no licence lets us copy. Here, the plant is that of Hagan, Demuth and De Jesus, "An introduction to the use of neural
networks in control systems" (2002), and the controller has the form of theirs, NARMA-L2 with 9 units in each network,
trained by `levitation_training` on 3,000 random transitions. No number compares with the competition's. The second
requirement of NN, NNx, describes the overshoot of the original controller, and is left out.

Instance 1 here: 12 references, each held for 3.3 s, since the competition wants 3 s or more between steps. Instance 2:
3 references, each held for 13.3 s.
"""

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.input_signals import every, held

END = 40.0
"""s."""
STEP = 0.01
"""s, of the controller and of the solver (RK4)."""
AHEAD = 9
"""Steps after which the controller wants the reference reached with a constant current."""
UNITS = 9
CURRENTS = (-1.0, 4.0)
"""A."""
REFERENCES = (1.0, 3.0)
START = 0.5
"""Position."""
LOWEST = 0.05
"""Position of the magnet on the coil, which the published plant does not have: its force is infinite at 0."""

GRAVITY = 9.8
FORCE = 5.0
"""alpha / M = 15 / 3."""
FRICTION = 4.0
"""beta / M = 12 / 3."""

BOUND = "0.005 + 0.03 * abs(reference)"
FORMULA = (
    f"always[1,37] (abs(position - reference) > {BOUND} implies "
    f"eventually[0,2] always[0,1] abs(position - reference) <= {BOUND})"
)

# fmt: off
WEIGHTS: tuple[float, ...] = (
    1.13325, 0.37701, 0.92662, -2.43228, -0.05751, 0.04209, 0.43531, 0.08247, -0.12827, 0.02092, -0.29182, 0.01477,
    3.1828, 0.13853, -0.04901, 0.17955, 0.20597, -0.01622, -1.82522, 0.03947, 0.03374, -0.43516, -0.09149, -0.04873,
    -2.02277, 3.73247, -0.06743, 0.14634, -1.49772, -0.11119, -1.28759, 1.75706, 0.43179, -1.33606, 0.06771,
    0.23819, -0.01277, -1.47531, 0.84612, -1.12377, -0.46641, -1.47318, 1.22064, -2.11862, 0.00344, 0.03786,
    -3.34221, -0.10337, -0.10771, 2.91747, 0.10407, 0.07066, 2.38566, -0.33523, 2.56188, 1.50223, -0.2566, 2.50298,
    3.17102, -0.38944, 2.77192, -3.975, 0.44613, -3.08475, -7.2906, -0.327, -0.14897, 1.81932, -0.29234, 2.50776,
    -0.01994, 0.00039, 0.009, -2.64845, 3.22926, -0.2722, -0.21494, -0.3416, 0.42399, -6.36693, -0.2326, 1.24775,
    -0.42685, -2.26486, -1.62736, -0.57199, 1.13083, 0.36865, -0.27168, 1.4328, 1.58346, 0.24335,
)
# fmt: on
"""Of the free motion, then of the effect of the current: inputs of the units, their biases, outputs, and one offset."""


def fallen(position: float, velocity: float, current: float) -> tuple[float, float]:
    """Return position and velocity of the magnet one step later."""
    push = FORCE * current * abs(current)
    h = STEP

    def acceleration(at: float, moving: float) -> float:
        return push / max(at, LOWEST) - GRAVITY - FRICTION * moving

    a1 = acceleration(position, velocity)
    v2 = velocity + h / 2 * a1
    a2 = acceleration(position + h / 2 * velocity, v2)
    v3 = velocity + h / 2 * a2
    a3 = acceleration(position + h / 2 * v2, v3)
    v4 = velocity + h * a3
    a4 = acceleration(position + h * v3, v4)
    return position + h / 6 * (velocity + 2 * (v2 + v3) + v4), velocity + h / 6 * (a1 + 2 * (a2 + a3) + a4)


def scaled(position: float, before: float, current: float) -> tuple[float, float, float]:
    """Return the inputs of the networks: the position now, its change in the last step, and the last current."""
    return position / 2.5 - 1.0, (position - before) / 0.04, current / 2.5 - 0.6


def networks() -> tuple[Floats, Floats, Floats, Floats]:
    """Return the weights of both networks as one: into the units (18, 3), biases (18,), out (2, 18), offsets (2,)."""
    free, gain = (np.split(part, [3 * UNITS, 4 * UNITS, 5 * UNITS]) for part in np.split(np.array(WEIGHTS), 2))
    zeros = np.zeros(UNITS)
    return (
        np.vstack([free[0].reshape(UNITS, 3), gain[0].reshape(UNITS, 3)]),
        np.concatenate([free[1], gain[1]]),
        np.vstack([np.concatenate([free[2], zeros]), np.concatenate([zeros, gain[2]])]),
        np.concatenate([free[3], gain[3]]),
    )


def rollout(reference: Floats, times: Floats) -> Rollout:
    """Simulate under a reference at each step."""
    into, bias, out, offset = networks()
    position = before = START
    velocity = current = 0.0
    columns = np.empty((len(times), 2))
    for row, wanted in enumerate(reference.tolist()):
        free, gain = (out @ np.tanh(into @ scaled(position, before, current) + bias) + offset).tolist()
        demanded = 2.5 * ((wanted / 2.5 - 1.0 - free) / gain + 0.6)
        current = min(max(demanded, CURRENTS[0]), CURRENTS[1])
        columns[row] = position, current
        before = position
        position, velocity = fallen(position, velocity, current)
        if position < LOWEST:
            position, velocity = LOWEST, 0.0
    return times, {"position": columns[:, 0], "current": columns[:, 1], "reference": reference}


def simulate(point: Floats) -> Rollout:
    """Simulate the references that `point` has."""
    times = every(STEP, END)
    return rollout(held(point, END, times), times)


BENCHMARKS = tuple(
    Benchmark("MAGLEV", instance, (REFERENCES[0],) * steps, (REFERENCES[1],) * steps, FORMULA, simulate)
    for instance, steps in ((1, 12), (2, 3))
)

"""How the two networks of `levitation` were trained, apart because it is run by hand and needs scipy.

    python -m tests.studies.falsification.models.levitation_training

prints their weights anew. The last digits depend on the platform.
"""

import sys

import numpy as np
from scipy.optimize import least_squares

from tests.studies.falsification.benchmark import Floats
from tests.studies.falsification.models.levitation import AHEAD, CURRENTS, UNITS, fallen, scaled

SAMPLES = 3000
EVALUATIONS = 300
WEIGHTS = 5 * UNITS + 1
"""Of one network: three inputs, a bias and an output for each unit, and a bias of the output."""


def transitions(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return scaled inputs (n, 3), currents (n,) and later positions (n,) of magnets in random states."""
    rows = []
    low, high = CURRENTS
    for before, start, last, current in rng.uniform(
        (0.3, -4.0, low, low), (4.5, 4.0, high, high), (SAMPLES, 4)
    ).tolist():
        position, velocity = fallen(before, start, last)
        later, moving = position, velocity
        for _ in range(AHEAD):
            later, moving = fallen(later, moving, current)
        if 0.1 < later < 6.0 and position > 0.2:
            rows.append((*scaled(position, before, last), current / 2.5 - 0.6, later / 2.5 - 1.0))
    table = np.array(rows)
    return table[:, :3], table[:, 3], table[:, 4]


def output(weights: Floats, inputs: Floats) -> tuple[Floats, Floats]:
    """Return what one network makes of the inputs, and the derivative by its weights."""
    into, bias, out, offset = np.split(weights, [3 * UNITS, 4 * UNITS, 5 * UNITS])
    units = np.tanh(inputs @ into.reshape(UNITS, 3).T + bias)
    slopes = (1.0 - units**2) * out
    by_inputs = (slopes[:, :, None] * inputs[:, None, :]).reshape(len(inputs), -1)
    return units @ out + offset, np.hstack([by_inputs, slopes, units, np.ones((len(inputs), 1))])


def train() -> Floats:
    """Return the weights of both networks after each other: Levenberg-Marquardt from a random start."""
    rng = np.random.default_rng(7)
    inputs, current, later = transitions(rng)

    def residuals(weights: Floats) -> Floats:
        (free, _), (gain, _) = (output(part, inputs) for part in np.split(weights, 2))
        return free + gain * current - later

    def derivative(weights: Floats) -> Floats:
        (_, free), (_, gain) = (output(part, inputs) for part in np.split(weights, 2))
        return np.hstack([free, gain * current[:, None]])

    start = rng.normal(0.0, 0.5, 2 * WEIGHTS)
    found = least_squares(residuals, start, derivative, method="lm", max_nfev=EVALUATIONS)
    return np.asarray(found.x)


if __name__ == "__main__":
    sys.stdout.write(f"{[round(weight, 5) for weight in train().tolist()]}\n")

"""Points of the unit box among which a search chooses: everywhere, on its faces, and around its worst starts."""

import numpy as np

from ..gp.kernels import Floats

WIDE, FACES, NEAR, SNAPPED = 256, 192, 64, 24
"""Points in the whole box, on its faces, and of each worst start: around it, and with parameters at an end."""
ROUNDS = (0.1, 0.03, 0.01)
"""Steps around the best candidates, in length scales."""
BEST, COPIES = 6, 24


def choices_among(rng: np.random.Generator, worst: Floats) -> Floats:
    """Return candidates (m, p), given the worst starts (k, p)."""
    k, dimension = worst.shape
    return np.vstack(
        [
            rng.random((WIDE, dimension)),
            # From one parameter at an end to a corner: failures of control systems like the ends of ranges.
            _at_ends(rng, rng.random((FACES, dimension)), rng.random((FACES, 1))),
            _around(rng, np.repeat(worst, NEAR, axis=0)),
            _at_ends(rng, np.repeat(worst, SNAPPED, axis=0), np.full((k * SNAPPED, 1), max(0.25, 1 / dimension))),
        ]
    )


def nearby(rng: np.random.Generator, best: Floats, steps: Floats) -> Floats:
    """Return the best candidates (k, p) and copies that differ by about `steps` (p,) in some of the parameters."""
    copies = np.repeat(best, COPIES, axis=0)
    moved = rng.random(copies.shape) < max(0.3, 2 / copies.shape[1])
    return np.vstack([best, np.clip(copies + steps * rng.standard_normal(copies.shape) * moved, 0.0, 1.0)])


def _at_ends(rng: np.random.Generator, points: Floats, probability: Floats) -> Floats:
    """Return the points with each parameter at one of its ends with the probability of its row, shape (n, 1)."""
    chosen, ends = rng.random(points.shape) < probability, (rng.random(points.shape) < 0.5).astype(np.float64)
    return np.where(chosen, ends, points)


def _around(rng: np.random.Generator, points: Floats) -> Floats:
    """Return the points moved by steps from a 200th to a third of a range, half of them in a few parameters only."""
    n, dimension = points.shape
    steps = 10.0 ** rng.uniform(-2.3, -0.5, (n, 1))
    share = np.where(rng.random((n, 1)) < 0.5, 1.0, max(0.2, 1.5 / dimension))
    moved = rng.random(points.shape) < share
    return np.clip(points + steps * rng.standard_normal(points.shape) * moved, 0.0, 1.0)

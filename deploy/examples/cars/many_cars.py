"""The cars of `cars.py`, many rollouts in one call: arrays over rollouts and samples, with reactions from `seeds`."""

import numpy as np

import perfbound as pb


@pb.system(
    parameters={"gap": pb.Parameter(5, 60, unit="m"), "speed": pb.Parameter(5, 35, unit="m/s")},
    columns={"distance": "m", "speed": "m/s"},
    step=0.05,
    vectorised=True,
)
def cars(gap, speed, *, seeds, horizon, reaction=0.5):
    """Brake ahead with 6 m/s2, and behind with 7 m/s2 after a reaction time that varies by a fifth."""
    gap, speed = gap[:, np.newaxis], speed[:, np.newaxis]  # (rollouts, 1): each column is (rollouts, samples)
    t = np.arange(0.0, horizon + 0.025, 0.05)
    delay = reaction * (0.8 + 0.4 * pb.uniform(seeds, 1))
    ahead = np.maximum(speed - 6 * t, 0)
    follower = np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
    return gap + 0.05 * np.cumsum(ahead - follower, axis=1), follower

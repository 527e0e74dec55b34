"""The cars of `cars.py` twice: as the model has them, and with a reaction time that varies."""

import numpy as np

import perfbound as pb


@pb.system(
    parameters={"gap": pb.Parameter(5, 60, unit="m"), "speed": pb.Parameter(5, 35, unit="m/s")},
    columns={"distance": "m", "speed": "m/s"},
    step=0.05,
    noisy=["true"],
)
def cars(gap, speed, *, seed, horizon, variant, reaction=0.5):
    """Brake ahead with 6 m/s2, and behind with 7 m/s2 after a reaction time that varies where the variant is true."""
    t = np.arange(0.0, horizon + 0.025, 0.05)
    delay = reaction * (np.random.default_rng(seed).uniform(0.8, 1.2) if variant == "true" else 1.0)
    ahead = np.maximum(speed - 6 * t, 0)
    follower = np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
    return gap + 0.05 * np.cumsum(ahead - follower), follower

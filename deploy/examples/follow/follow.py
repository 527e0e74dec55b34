"""A car with adaptive cruise control behind another one that brakes and accelerates as it likes."""

import numpy as np

import perfbound as pb


@pb.system(
    parameters={
        "ahead": pb.Parameter(-6, 3, unit="m/s2", signal=True),
        "gap": pb.Parameter(5, 80, unit="m"),
        "speed": pb.Parameter(5, 35, unit="m/s"),
    },
    columns={"distance": "m", "speed": "m/s", "ahead": "m/s"},
    step=0.05,
)
def follow(ahead, gap, speed, *, horizon, time_gap=1.4):
    """Keep 3 m and the time gap; both cars begin with the same speed."""
    t = np.arange(0.0, horizon + 0.025, 0.05)
    distance, own, leader = gap, speed, speed
    samples = [(distance, own, leader)]
    for demand in ahead(t[:-1]):
        control = 0.25 * (distance - 3.0 - time_gap * own) + 0.8 * (leader - own)
        own = max(own + 0.05 * min(max(control, -7.0), 2.0), 0.0)
        leader = max(leader + 0.05 * demand, 0.0)
        distance += 0.05 * (leader - own)
        samples.append((distance, own, leader))
    return np.array(samples)

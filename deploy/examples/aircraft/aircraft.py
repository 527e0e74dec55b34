"""A Cessna 172 in JSBSim, as a program: a line of JSON for each rollout on stdin, its samples into a file."""

import json
import math
import os
import sys

import jsbsim
import numpy as np

FOOT, KNOT = 0.3048, 0.514444  # m, m/s
RATE, EVERY = 120, 12  # steps per second, and per sample
HEIGHT = 1000.0  # m


def flight(bank: float, speed: float, horizon: float) -> np.ndarray:
    """Start banked, with the wing leveller on; return height lost (m), bank (rad) and speed (m/s)."""
    aircraft = jsbsim.FGFDMExec(None)
    aircraft.load_model("c172x")
    aircraft.set_dt(1 / RATE)
    aircraft["ic/h-sl-ft"] = HEIGHT / FOOT
    aircraft["ic/vc-kts"] = speed / KNOT
    aircraft["ic/phi-deg"] = math.degrees(bank)
    aircraft.run_ic()
    aircraft["propulsion/set-running"] = -1  # all engines
    aircraft["fcs/throttle-cmd-norm"] = 0.7
    aircraft["ap/attitude_hold"] = 1
    rows = []
    for step in range(round(horizon * RATE) + 1):
        if step % EVERY == 0:
            lost = HEIGHT - aircraft["position/h-sl-meters"]
            rows.append((lost, aircraft["attitude/phi-rad"], aircraft["velocities/vc-kts"] * KNOT))
        aircraft.run()
    return np.array(rows)


answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # JSBSim prints
os.chdir(os.environ["PERFBOUND_SCRATCH"])  # and writes a file
for line in sys.stdin:
    request = json.loads(line)
    answer = {"request": request["request"]}
    # JSBSim has the aircraft, and no file of this folder: its version is in the campaign file.
    if jsbsim.__version__ == request["options"]["jsbsim"]:
        np.save(request["path"], flight(**request["start"], horizon=request["horizon"]))
        answer["done"] = True
    else:
        answer["error"] = f"JSBSim is {jsbsim.__version__} here"
    print(json.dumps(answer), file=answers, flush=True)

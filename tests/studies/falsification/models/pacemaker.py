"""The atrial pacing of a pacemaker: PM of the competition.

The state machine of the model "Model1_Scenario1_Correct" (Mehan et al., McMaster University, 2022, after Boston
Scientific's pacemaker specification), in the mode AOO that its constant input selects; own code. Left out: the other
modes and the pins of the hardware, which do not reach the counter.

No input can violate the requirement here: every beat takes from 0.667 to 1.2 s, so there are from 8 to 15 in 10 s.
FalCAuN found no failure in the competition of 2024 either. Instance 1 here: linear between 5 knots. Instance 2: 5
values, each held for 2 s.
"""

from functools import partial

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.inputs import held, linear

END = 10.0
"""s."""
STEPS = 10_000
"""Of 1 ms, as the model has them."""
EVERY = 10
"""Steps from one sample to the next; the counter never decreases."""
WIDTH = 2
"""Of a pulse, ms."""
KNOTS = 5
RATES = (50.0, 90.0)
"""Of the lower limit of the heart rate, beats per minute."""
FORMULA = "always[0,10] pace_count <= 15 and eventually[0,10] pace_count >= 8"


def counts(period: Floats) -> Floats:
    """Return the number of pulses up to each step under a period in ms at each step.

    At step 0 the machine chooses its mode, and at step 1 it starts to charge. A charge ends at the first step that is
    a period less the width of a pulse after its start, with the period as it then is.
    """
    pulses = np.zeros(len(period))
    waits = (period - WIDTH).tolist()
    started, step = 1, 2
    while step < len(waits):
        if step - started >= waits[step]:
            pulses[step:] += 1
            started = step + WIDTH
            step = started
        step += 1
    return pulses


def simulate(point: Floats, *, knots: bool) -> Rollout:
    """Simulate the limit of the heart rate that `point` has at knots, or holds."""
    times = np.arange(STEPS + 1) / 1000.0
    rate = np.floor(linear(point, END, times) if knots else held(point, END / len(point), times))
    sampled = slice(None, None, EVERY)
    period = 60_000.0 / rate
    return times[sampled], {
        "period": period[sampled],
        "rate": rate[sampled],
        "pace_count": counts(period)[sampled],
    }


BENCHMARKS = tuple(
    Benchmark(
        "PM",
        instance,
        (RATES[0],) * KNOTS,
        (RATES[1],) * KNOTS,
        FORMULA,
        partial(simulate, knots=instance == 1),
        inputs=(KNOTS,),
    )
    for instance in (1, 2)
)

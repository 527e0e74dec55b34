"""The steam condenser with a recurrent network as controller: SC of the competition.

Plant: energy and mass balance of a shell-and-tube condenser as in Yaghoubi and Fainekos, "Gray-box Adversarial Testing
for Control Systems with Machine Learning Components" (HSCC 2019), with its tables of saturated steam. Controller: the
trained network of that paper, 3 units; its 34 weights are data of the competition's model file, which repositories
under the MIT licence hold. Own code; RK4 with 0.05 s where the competition has a variable step of at most 0.1 s.

Instance 1 here: linear between 141 knots, one each 0.25 s. The known counterexamples of the competition switch about
100 times from one end of the range to the other and pass 87.5 kPa by 0.002; from the impulse response of this model,
at least 87.501 kPa is possible with 141 knots, and 87.482 with 36. Instance 2: 20 values, each held for 1.75 s, with
which zlscheck found none in 15,000 simulations (2020), and 87.480 seems the most.
"""

import math
from functools import partial

import numpy as np

from tests.studies.falsification.benchmark import Benchmark, Floats, Rollout
from tests.studies.falsification.models.inputs import held, linear, steps

END = 35.0
"""s."""
STEP = 0.05
KNOTS = 141
SEGMENTS = 20
FORMULA = "always[30,35] (87 <= pressure <= 87.5)"

VOLUME = 3.0
"""Of the steam, m^3."""
GAS_CONSTANT = 0.461526
"""Of steam, kJ/(kg K)."""
HOLDUP = 500.0
"""Of cooling water, kg."""
HEAT_CAPACITY = 4.2
"""Of water, kJ/(kg K)."""
INLET = 60.0
"""Temperature of the cooling water at the inlet, degrees Celsius."""
NOMINAL_FLOW = 107.8880952381
"""Of cooling water, kg/s; the controller adds to it."""
NOMINAL_STEAM = 4.0
"""kg/s."""
SETPOINTS = (90.0, 87.0)
"""Of the pressure, kPa: before and after `SETPOINT_CHANGE`."""
SETPOINT_CHANGE = 2.0

# Saturated steam from 50 to 110 kPa in steps of 10: temperature in degrees Celsius, heat of evaporation in kJ/kg.
BOILING = (81.3167, 85.9258, 89.9315, 93.4854, 96.6870, 99.6059, 102.2923)
EVAPORATION = (2305.42, 2293.64, 2283.30, 2274.05, 2265.65, 2257.92, 2250.76)

# The network: p = scaled error; a = tanh(INPUT p + DIRECT d + TWICE e + BIAS) with d = a/(s + 10), e = d/(s + 10).
INPUT = (-0.36932254958803395, 0.37111199431650393, -0.5273628058411884)
DIRECT = (
    (0.44769854454577174, 1.1961840315574388, 1.1412233787458486),
    (-0.1666873035945436, -0.016432941671533533, -0.2213279634236716),
    (0.24187644262601646, -0.6696328523822819, -1.0984401489322673),
)
TWICE = (
    (0.7200162301978621, -0.37547125154051064, -0.6154676090487433),
    (-0.03720622409555299, 0.0598746719216033, 0.08020259272911583),
    (0.029109804692608397, 1.3722216833345802, 0.6616690666952404),
)
BIAS = (0.401290502963486, -0.12475735064274925, -1.3584541012442735)
OUTPUT = (-0.22749313555095124, 2.0804967759906643, -0.5664480988615816)
OUTPUT_BIAS = -0.3322786668411084
ERROR_RANGE = (-3.7742393716738434, 5.7997431225043385)
FLOW_RANGE = (-30.855068745036114, 66.87926496596293)
"""Ranges that the network maps to [-1, 1] and from it."""

State = tuple[float, ...]
"""pressure, outlet temperature, flow of cooling water, measured pressure, three d, three e."""


def saturated(table: tuple[float, ...], pressure: float) -> float:
    """Return the value of a table of saturated steam, linear between its rows and beyond its ends."""
    row = min(max(int((pressure - 50.0) / 10.0), 0), 5)
    return table[row] + (table[row + 1] - table[row]) * (pressure - 50.0 - 10.0 * row) / 10.0


def layer(error: float, d: tuple[float, ...], e: tuple[float, ...]) -> tuple[float, float, float]:
    """Return the outputs of the three units for an error of the pressure in kPa."""
    low, high = ERROR_RANGE
    scaled = 2.0 * (error - low) / (high - low) - 1.0
    d1, d2, d3 = d
    e1, e2, e3 = e
    first, second, third = (
        math.tanh(w * scaled + u[0] * d1 + u[1] * d2 + u[2] * d3 + v[0] * e1 + v[1] * e2 + v[2] * e3 + b)
        for w, u, v, b in zip(INPUT, DIRECT, TWICE, BIAS, strict=True)
    )
    return first, second, third


def demanded_flow(units: tuple[float, float, float]) -> float:
    """Return the flow of cooling water that the network demands, in kg/s."""
    out = OUTPUT[0] * units[0] + OUTPUT[1] * units[1] + OUTPUT[2] * units[2] + OUTPUT_BIAS
    low, high = FLOW_RANGE
    return min(max(NOMINAL_FLOW + low + (out + 1.0) * (high - low) / 2.0, 0.0), 200.0)


def heat(pressure: float, outlet: float, flow: float) -> float:
    """Return the heat in kW from steam to water: the logarithmic mean of the differences over a resistance."""
    boiling = saturated(BOILING, pressure)
    mean = (outlet - INLET) / math.log((boiling - INLET) / (boiling - outlet))
    return mean / (0.0872924756541668 / math.pow(flow, 0.8) + 0.00073786772008033)


def rates(state: State, steam: float, setpoint: float) -> State:
    """Return the derivative of the state."""
    pressure, outlet, flow, measured = state[:4]
    d, e = state[4:7], state[7:]
    units = layer(measured - setpoint, d, e)
    to_water = heat(pressure, outlet, flow)
    condensed = to_water / saturated(EVAPORATION, pressure)
    # The published model has the temperature of the steam in degrees Celsius here.
    return (
        GAS_CONSTANT / VOLUME * saturated(BOILING, pressure) * (steam - condensed),
        (to_water / HEAT_CAPACITY + (INLET - outlet) * flow) / HOLDUP,
        demanded_flow(units) - flow,
        2.0 * (pressure - measured),
        *(unit - 10.0 * x for unit, x in zip(units, d, strict=True)),
        *(x - 10.0 * y for x, y in zip(d, e, strict=True)),
    )


def advance(state: State, steam: float, setpoint: float) -> State:
    """Return the state one step later (RK4, inputs held)."""

    def moved(by: float, along: State) -> State:
        return tuple([x + by * k for x, k in zip(state, along, strict=True)])

    k1 = rates(state, steam, setpoint)
    k2 = rates(moved(STEP / 2, k1), steam, setpoint)
    k3 = rates(moved(STEP / 2, k2), steam, setpoint)
    k4 = rates(moved(STEP, k3), steam, setpoint)
    return tuple(
        [x + STEP / 6 * (a + 2 * (b + c) + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)],
    )


START: State = (90.0, 80.0, NOMINAL_FLOW, 90.0) + (0.0,) * 6


def rollout(steam: Floats, times: Floats) -> Rollout:
    """Simulate under a flow of steam in kg/s at `times`, multiples of the step."""
    state = START
    columns = np.empty((len(times), 4))
    for row, (time, flow) in enumerate(zip(times.tolist(), steam.tolist(), strict=True)):
        columns[row] = state[:4]
        state = advance(state, flow, SETPOINTS[time >= SETPOINT_CHANGE - STEP / 2])
    names = ("steam_pressure", "temperature", "cooling_flow", "pressure")
    return times, dict(zip(names, columns.T, strict=True)) | {"steam": steam}


def simulate(point: Floats, *, knots: bool) -> Rollout:
    """Simulate the flow of steam that `point` has at knots, or holds."""
    times = steps(END, STEP)
    return rollout(linear(point, END, times) if knots else held(point, END / SEGMENTS, times), times)


BENCHMARKS = tuple(
    Benchmark(
        "SC",
        instance,
        (3.99,) * values,
        (4.01,) * values,
        FORMULA,
        partial(simulate, knots=instance == 1),
        inputs=(values,),
    )
    for instance, values in ((1, KNOTS), (2, SEGMENTS))
)

"""The models of the falsification competition against equilibria, published numbers and symmetries."""

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.stl.robustness import robustness
from tests.studies.falsification.benchmark import Benchmark, Floats
from tests.studies.falsification.models import (
    fighter_tables,
    fuel_control,
    ground_collision,
    inputs,
    pacemaker,
    steam_condenser,
)

MODELS = (fuel_control, ground_collision, pacemaker, steam_condenser)
ALL = [benchmark for model in MODELS for benchmark in model.BENCHMARKS]


def score(benchmark: Benchmark, times: Floats, columns: Mapping[str, Floats]) -> float:
    """Return the robustness of a rollout."""
    return robustness(benchmark.parsed, ("t", *columns), np.column_stack([times, *columns.values()]))


@pytest.mark.parametrize("benchmark", ALL, ids=lambda b: f"{b.name}-{b.instance}")
def test_a_rollout_from_the_middle_of_the_box_is_scored_and_the_same_each_time(benchmark: Benchmark) -> None:
    """The formula reads columns that there are, up to the end, and nothing is random."""
    middle = (np.array(benchmark.low) + np.array(benchmark.high)) / 2
    first, again = (score(benchmark, *benchmark.simulate(middle)) for _ in range(2))
    assert first == again
    assert math.isfinite(first)
    assert len(benchmark.low) == len(benchmark.high) == benchmark.dimension
    assert all(low < high for low, high in zip(benchmark.low, benchmark.high, strict=True))


def test_inputs_are_held_over_equal_intervals_or_linear_between_knots() -> None:
    times = inputs.steps(35.0, 0.05)
    values = np.arange(20.0)
    assert np.array_equal(np.bincount(inputs.held(values, 1.75, times).astype(int)), [35] * 19 + [36])
    assert inputs.linear(values, 35.0, times)[350] == pytest.approx(9.5)


def test_the_condenser_rests_where_heat_and_mass_balance() -> None:
    _, columns = steam_condenser.simulate(np.full(20, 4.0), knots=False)
    pressure, temperature, flow = (columns[name][-1] for name in ("pressure", "temperature", "cooling_flow"))
    heat = 4.0 * steam_condenser.saturated(steam_condenser.EVAPORATION, pressure)
    assert heat == pytest.approx(flow * 4.2 * (temperature - 60.0), rel=1e-4)
    assert heat == pytest.approx(steam_condenser.heat(pressure, temperature, flow), rel=1e-4)
    # The published network leaves an offset to the setpoint of 87 kPa, within the requirement.
    assert 87.0 < pressure < 87.5


def test_the_condenser_starts_at_its_published_operating_point() -> None:
    """UA = 356.972 kW/K at the nominal flow, and pressure and temperature rest there under 4 kg/s of steam."""
    flow = steam_condenser.NOMINAL_FLOW
    assert 1.0 / (0.0872924756541668 / flow**0.8 + 0.00073786772008033) == pytest.approx(356.972413581334, rel=1e-6)
    assert steam_condenser.heat(90.0, 80.0, flow) == pytest.approx(4.0 * 2265.65, rel=1e-4)
    assert steam_condenser.rates(steam_condenser.START, 4.0, 90.0)[:2] == pytest.approx((0.0, 0.0), abs=2e-3)


def test_the_condenser_fails_under_its_worst_switching_input_alone() -> None:
    """By some 0.002 kPa, as under the published counterexamples; the input follows from the impulse response."""
    times = inputs.steps(steam_condenser.END, steam_condenser.STEP)
    calm = np.full(len(times), 4.0)
    pushed = calm.copy()
    pushed[100] += 0.1
    at_rest, answer = (steam_condenser.rollout(steam, times)[1]["pressure"] for steam in (calm, pushed))
    worst = np.where(np.append((answer - at_rest)[:100:-1], np.zeros(101)) > 0.0, 4.01, 3.99)
    requirement = steam_condenser.BENCHMARKS[0]
    assert -0.01 < score(requirement, *steam_condenser.rollout(worst, times)) < 0.0
    assert score(requirement, *steam_condenser.rollout(calm, times)) > 0.2


@pytest.mark.parametrize(("rate", "pulses"), [(50.0, 8), (60.0, 10), (90.0, 14)])
def test_the_pacemaker_paces_at_a_constant_limit(rate: float, pulses: int) -> None:
    _, columns = pacemaker.simulate(np.full(5, rate), knots=True)
    assert columns["pace_count"][-1] == pulses
    assert np.all(np.diff(columns["pace_count"]) >= 0)


def test_the_pulse_of_a_pacemaker_follows_the_limit_at_its_time() -> None:
    """After a change from 50 to 90 beats within a period, the next beat comes at once if the new period has passed."""
    period = np.full(2001, 1200.0)
    period[900:] = 60_000 / 90
    assert np.flatnonzero(np.diff(pacemaker.counts(period)))[0] + 1 == 900


@pytest.mark.parametrize(("pedal", "ratio"), [(0.0, 14.7), (20.0, 14.7), (60.0, 14.7), (70.0, 12.5)])
def test_the_air_fuel_ratio_settles_at_the_reference(pedal: float, ratio: float) -> None:
    """14.7 in the normal mode, and 12.5 in the power mode, which is open loop."""
    times, columns = fuel_control.simulate(np.array([pedal] * 10 + [1000.0]))
    late = times > 30.0
    assert columns["ratio"][late] == pytest.approx(ratio, abs=1e-3)
    assert np.all(columns["open_loop"][times < 9.9] == 1.0)
    assert np.all(columns["open_loop"][late] == (ratio == 12.5))


def test_the_manifold_rests_where_throttle_and_pump_agree() -> None:
    omega = 1000.0 * math.pi / 30.0
    pressure = fuel_control.manifold(np.full(2000, 20.0), omega)[-1:]
    through = fuel_control.opening(20.0) * 2.0 * np.sqrt(pressure - pressure**2)
    assert through == pytest.approx(fuel_control.pumped(pressure, omega), rel=1e-9)


def test_the_gas_in_the_exhaust_arrives_after_its_delay() -> None:
    times = inputs.steps(3.0, 0.01)
    emitted = fuel_control.emission_times(times, np.full(len(times), 0.25))
    assert np.all(emitted[:25] == -1.0)
    assert emitted[26:] == pytest.approx(times[26:] - 0.25)


def test_the_tables_of_the_engine_have_their_published_corners() -> None:
    charge = np.array([0.1, 0.15, 0.4])
    at = fuel_control.looked_up(fuel_control.VAPOUR, fuel_control.WALL_SPEEDS, fuel_control.WALL_CHARGES, 1000, charge)
    assert at == pytest.approx([0.8, 0.75, 0.6])
    slow = fuel_control.looked_up(
        fuel_control.DELAY, fuel_control.DELAY_SPEEDS, fuel_control.DELAY_CHARGES, 900, charge
    )
    assert slow[1] == pytest.approx(0.35)


def test_the_aircraft_has_the_trim_of_its_textbook() -> None:
    """Stevens and Lewis, table 3.6-3: level at 502 ft/s at sea level, throttle 0.1385, elevator -0.7588 degrees."""
    attack = 0.03691
    still, _, _ = fighter_tables.coefficients(math.degrees(attack), 0.0, -0.7588)
    pressure = 0.5 * 2.377e-3 * 502.0**2 * 300.0
    thrust = fighter_tables.thrust(64.94 * 0.1385, 0.0, 502.0 / math.sqrt(1.4 * 1716.3 * 519.0))
    weight = 32.17 / 1.57e-3
    assert (pressure * still[0] + thrust) / weight == pytest.approx(math.sin(attack), abs=1e-3)
    assert -pressure * still[1] / weight == pytest.approx(math.cos(attack), abs=3e-3)
    assert still[3] == pytest.approx(0.0, abs=1e-4)
    assert still[2] == still[4] == 0.0


def test_the_aerodynamics_is_symmetric() -> None:
    left, _, _ = fighter_tables.coefficients(12.0, 7.0, 3.0)
    right, _, _ = fighter_tables.coefficients(12.0, -7.0, 3.0)
    assert [left[0], left[1], -left[2], left[3], -left[4]] == pytest.approx(right)


def test_the_yaw_at_the_start_does_not_matter_to_the_altitude() -> None:
    low, high = np.array(ground_collision.LOW), np.array(ground_collision.HIGH)
    start = (low + high) / 2
    turned = np.where([False, False, True], low, start)
    one, other = (ground_collision.simulate(x, altitude=2338.0, end=3.0)[1]["altitude"] for x in (start, turned))
    assert one == pytest.approx(other, abs=1e-6)


def test_the_autopilot_rolls_and_then_pulls_to_a_climb() -> None:
    start = (np.array(ground_collision.LOW) + np.array(ground_collision.HIGH)) / 2
    _, columns = ground_collision.simulate(start, altitude=4040.0)
    modes = columns["mode"]
    order = [mode for mode, following in pairwise([*modes, math.inf]) if mode != following]
    assert order == [ground_collision.ROLLING, ground_collision.PULLING, ground_collision.STANDBY]
    standby = modes == ground_collision.STANDBY
    assert columns["pitch"][standby][0] > columns["attack"][standby][0]
    # The reference implementation of the benchmark, from roll 0.638, pitch -1.137 and yaw -1.026, turns at 2055.5 ft.
    _, known = ground_collision.simulate(np.array([0.638, -1.137, -1.026]), altitude=4040.0)
    assert known["altitude"].min() == pytest.approx(2055.5, abs=5.0)

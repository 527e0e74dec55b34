"""Input signals: functions of time through knots, and systems whose parameters they are."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from perfbound.schemas.errors import SimulationError
from perfbound.schemas.file.signals import SignalKind, SignalShape
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Parameter, SystemSpec, differences
from perfbound.schemas.trajectory.input_signal import InputSignal, start_values

KINDS: tuple[SignalKind, ...] = ("pchip", "linear", "constant")
KNOTS = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=8).map(tuple)
HORIZONS = st.floats(1e-3, 1e5)
SHAPES = (SignalShape(name="throttle", kind="linear", knots=3), SignalShape(name="wind", kind="constant", knots=2))


def spec() -> SystemSpec:
    """Return a system with two input signals around a number."""
    return SystemSpec(
        name="car",
        doc="",
        parameters=(
            Parameter(0, 1, name="throttle", signal=True),
            Parameter(5, 60, name="gap", unit="m"),
            Parameter(-9, 9, name="wind", unit="m/s", signal=True),
        ),
        columns=(Column(name="t", unit="s"), Column(name="v", unit="m/s")),
        max_horizon=100.0,
    )


# Functions of time


@given(kind=st.sampled_from(KINDS), knots=KNOTS, horizon=HORIZONS)
def test_a_signal_goes_through_its_knots_and_stays_between_them(
    kind: SignalKind, knots: tuple[float, ...], horizon: float
) -> None:
    signal = InputSignal(kind, knots, horizon)
    assert signal(np.array(signal.times)).tolist() == pytest.approx(list(knots), rel=1e-9, abs=1e-6)
    values = signal(np.linspace(-horizon, 2 * horizon, 301))
    assert min(knots) <= values.min()
    assert values.max() <= max(knots)
    # Before 0 and behind the horizon the ends hold.
    assert (signal(-1.0), signal(2 * horizon)) == (signal(0.0), signal(horizon))


@given(kind=st.sampled_from(KINDS), knots=KNOTS, horizon=HORIZONS, share=st.floats(0, 1))
def test_a_number_and_an_array_give_the_same(
    kind: SignalKind, knots: tuple[float, ...], horizon: float, share: float
) -> None:
    signal, t = InputSignal(kind, knots, horizon), share * horizon
    assert isinstance(signal(t), float)
    assert signal([[t, 0.0]]).tolist() == [[signal(t), signal(0.0)]]


@pytest.mark.parametrize(
    ("kind", "t", "value"),
    [
        ("constant", 1.0 - 1e-6, 0.0),
        ("constant", 1.0, 4.0),
        ("constant", 3.0, 2.0),
        ("linear", 0.75, 2.0),
        ("linear", 2.25, 3.0),
        ("pchip", 1.5, 4.0),
        ("pchip", 2.9999999, 2.0),
    ],
)
def test_values_of_each_kind(kind: SignalKind, t: float, value: float) -> None:
    assert InputSignal(kind, (0.0, 4.0, 2.0), 3.0)(t) == pytest.approx(value, abs=1e-6)


def test_pchip_does_not_overshoot_where_a_spline_does() -> None:
    signal = InputSignal("pchip", (0.0, 0.0, 1.0, 1.0), 3.0)
    values = signal(np.linspace(0.0, 3.0, 301))
    assert np.all(np.diff(values) >= 0)
    assert signal(1.5) == pytest.approx(0.5)


def test_a_step_comes_with_its_sample_whatever_the_rounding() -> None:
    signal = InputSignal("constant", (0.0, 1.0, 2.0, 3.0, 4.0), 1.0)
    # 0.6 < 3 * (1.0 / 5) in binary: one sample would otherwise get the value before.
    assert signal(np.arange(10) * 0.1).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert signal(0.6) == 3.0


@pytest.mark.parametrize("kind", KINDS)
def test_no_time_gives_no_value(kind: SignalKind) -> None:
    assert np.isnan(InputSignal(kind, (0.0, 1.0), 1.0)(float("nan")))


# Systems


def test_a_campaign_knows_the_knots_as_parameters() -> None:
    found = spec().spread(SHAPES)
    assert [(each.name, each.low, each.high, each.unit) for each in found.parameters] == [
        *((f"throttle_{k}", 0, 1, "") for k in range(3)),
        ("gap", 5, 60, "m"),
        *((f"wind_{k}", -9, 9, "m/s") for k in range(2)),
    ]
    assert found.signals == SHAPES
    assert [shape.knots for shape in spec().spread().signals] == [5, 5], "the default"


def test_the_identity_is_that_of_the_declared_system() -> None:
    found = spec().spread(SHAPES)
    assert found.declared == spec()
    assert found.spread() == found
    assert found.digest == spec().digest
    assert differences(found, spec()) == []
    plain = spec().model_copy(update={"parameters": (Parameter(5, 60, name="gap"),)})
    assert plain.spread(SHAPES) is plain
    assert found.digest != plain.digest


def test_a_parameter_without_signal_has_the_identity_of_before() -> None:
    assert "signal" not in json.dumps(
        spec().model_copy(update={"parameters": (Parameter(5, 60, name="gap"),)}).model_dump(mode="json")
    )
    assert Parameter(0, 1, name="x").model_dump() == {"name": "x", "unit": "", "low": 0, "high": 1}


def test_a_start_has_one_value_for_each_declared_parameter() -> None:
    values = start_values(spec().spread(SHAPES), (0.0, 0.5, 1.0, 30.0, -3.0, 4.0), 10.0)
    assert list(values) == ["throttle", "gap", "wind"]
    assert values["gap"] == 30.0
    assert values["throttle"] == InputSignal("linear", (0.0, 0.5, 1.0), 10.0)
    assert values["wind"] == InputSignal("constant", (-3.0, 4.0), 10.0)


def test_a_start_of_another_length_and_a_signal_without_time_are_refused() -> None:
    with pytest.raises(SimulationError, match="car takes 6 parameters, not 3"):
        start_values(spec().spread(SHAPES), (0.5, 30.0, 1.0), 10.0)
    with pytest.raises(SimulationError, match="give a horizon above 0 s"):
        start_values(spec().spread(SHAPES), (0.0, 0.5, 1.0, 30.0, -3.0, 4.0), 0.0)


def test_a_parameter_with_the_name_of_a_knot_is_refused() -> None:
    clash = (Parameter(0, 1, name="throttle", signal=True), Parameter(0, 1, name="throttle_12"))
    with pytest.raises(ValidationError, match="throttle_12 is the name of a knot of throttle"):
        SystemSpec.model_validate({**spec().model_dump(), "parameters": clash})


def test_requests_say_which_numbers_are_knots_and_others_stay_what_they_were() -> None:
    template = RequestTemplate.of(spec().spread(SHAPES), {}, horizon=10.0, visual=False)
    request = template.request(RolloutId("robustness", 0, "true", 0), (0.0, 0.5, 1.0, 30.0, -3.0, 4.0), 1)
    assert RolloutRequest.model_validate_json(request.model_dump_json()).signals == SHAPES
    assert "signals" not in request.model_copy(update={"signals": ()}).model_dump_json()
    assert request.words(template.spec).startswith("throttle_0 = 0, throttle_1 = 0.5, throttle_2 = 1, gap = 30")


@pytest.mark.integration
def test_linear_and_constant_need_no_scipy() -> None:
    """A worker takes half a second longer with it."""
    code = (
        "import sys; from perfbound.schemas.trajectory.input_signal import InputSignal as S;"
        "S('linear', (0., 1.), 1.)(0.5);"
        "S('constant', (0.,), 1.)(0.5); sys.exit('scipy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

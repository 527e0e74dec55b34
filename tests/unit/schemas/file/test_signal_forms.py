"""Forms of input signals in `[space]`: times, a rate, sines, steps and profiles, and formulas that name them."""

import itertools
import json
import tomllib
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import as_in_campaign, check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.defaults import file_schema
from perfbound.schemas.file.parameters import parameter_ranges, signal_shapes
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.toml_text import toml_file
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.input_signal import InputSignal, start_values
from tests.facts import says

HEAD = """specification = "always (abs(v - u) <= 5)"
method = "sample"
horizon = 20
system.name = "any"

[space]
"""
SINE = 'u = { signal = "sine", amplitude = [0, 2], frequency = [0.1, 2], unit = "m" }'
STEP = 'u = { signal = "step", at = 5, before = 10, after = [15, 25] }'
PROFILE = 'u = { profile = "p.csv" }\nx = [0, 1]'
RATE = 'u = { signal = "linear", knots = 3, low = 0, high = 1, rate = 0.05 }'
TIMES = 'u = { signal = "constant", times = [0, 2, 5, 20], low = 0, high = 1 }'
UNTIL = 'u = { signal = "linear", knots = 3, until = 10, low = 0, high = 1 }'
FORMS = (SINE, STEP, PROFILE, RATE, TIMES, UNTIL)
FILES = {
    "p.csv": b"t,value\n0,1\n5,3\n10,2\n",
    "wide.csv": b"0,1,3\n",
    "swapped.csv": b"value,t\n0,1\n",
    "late.csv": b"1,0\n",
    "double.csv": b"0,1\n0,2\n",
    "words.csv": b"t,value\n1,x\n",
    "long.csv": b"".join(b"%d,1\n" % t for t in range(5001)),
}
SPEC = SystemSpec(
    name="any",
    doc="",
    parameters=(Parameter(-99, 99, name="u", unit="m", signal=True), Parameter(0, 9, name="x")),
    columns=(Column(name="t", unit="s"), Column(name="v", unit="m")),
    max_horizon=100.0,
)


def beside(name: str) -> bytes:
    if name not in FILES:
        raise FileNotFoundError(2, "No such file")
    return FILES[name]


def parsed(space: str) -> CampaignConfig:
    return parse_campaign((HEAD + space).encode(), "c.toml", beside)


def signal(space: str, *x: float) -> InputSignal:
    """Return the input that a system gets from a start."""
    config = parsed(space if "\nx" in space else f"{space}\nx = [0, 1]")
    found = start_values(as_in_campaign(SPEC, config), (*x, 0.5), config.horizon)["u"]
    assert isinstance(found, InputSignal)
    return found


def ends(space: str) -> dict[str, tuple[float, float]]:
    config = parsed(space)
    assert isinstance(config.space, dict)
    return {name: (each.low, each.high) for name, each in parameter_ranges(config.space).items()}


def test_until_and_times_place_the_knots() -> None:
    assert signal(UNTIL, 0.0, 1.0, 0.5)([0, 5, 7.5, 10, 20]).tolist() == [0.0, 1.0, 0.75, 0.5, 0.5]
    assert signal(TIMES, 0.1, 0.2, 0.3, 0.4)([0, 1.9, 2, 5, 19.9, 20]).tolist() == [0.1, 0.1, 0.2, 0.3, 0.3, 0.4]
    between = TIMES.replace("20]", "7.3]").replace("constant", "linear")
    assert signal(between, 0.0, 0.0, 0.0, 1.0)([5, 7.3, 20]).tolist() == [0.0, 1.0, 1.0]
    assert list(ends(TIMES)) == ["u_0", "u_1", "u_2", "u_3"]
    constant = UNTIL.replace("linear", "constant")
    assert signal(constant, 0.1, 0.2, 0.3).times == pytest.approx((0, 10 / 3, 20 / 3))


def test_a_sine_has_its_numbers_as_parameters_and_its_range_follows() -> None:
    assert ends(SINE) == {"u_amplitude": (0.0, 2.0), "u_frequency": (0.1, 2.0)}
    config = parsed(f"{SINE.replace('unit', 'phase = [0, 1], offset = 3, unit')}\nx = [0, 1]")
    assert isinstance(config.space, dict)
    assert (config.space["u"].low, config.space["u"].high) == (1.0, 5.0)
    known = as_in_campaign(SPEC, config)
    assert [(each.name, each.unit) for each in known.parameters] == [
        ("u_amplitude", "m"),
        ("u_frequency", "Hz"),
        ("u_phase", "rad"),
        ("x", ""),
    ]
    assert known.declared == SPEC
    assert known.digest == SPEC.digest
    found = signal(SINE, 2.0, 0.25)
    assert found([0, 1, 2, 3]).tolist() == pytest.approx([0, 2, 0, -2], abs=1e-12)
    assert found.described == {"signal": "sine", "amplitude": 2.0, "frequency": 0.25, "phase": 0.0, "offset": 0.0}


def test_a_number_of_a_sine_may_have_a_distribution() -> None:
    space = 'u = { signal = "sine", amplitude = 1, frequency = { low = 0.1, high = 2, distribution = "lognormal", '
    config = parsed(f"{space}median = 0.5, sigma = 1 }} }}")
    assert isinstance(config.space, dict)
    assert config.space["u"].for_draws == ("frequency.distribution", "frequency.median", "frequency.sigma")
    assert parameter_ranges(config.space)["u_frequency"].median == 0.5


def test_a_step_is_constant_before_and_after_it() -> None:
    assert ends(STEP) == {"u_after": (15.0, 25.0)}
    found = signal(STEP, 20.0)
    assert found([0, 4.99, 5, 20]).tolist() == [10, 10, 20, 20]
    assert found.described == {"signal": "constant", "knots": [10.0, 20.0], "times": [0.0, 5.0]}
    assert signal(STEP.replace("5,", "0,", 1), 20.0)([0, 1]).tolist() == [20, 20]


def test_a_profile_has_no_parameters() -> None:
    assert ends(PROFILE) == {"x": (0.0, 1.0)}
    found = signal(PROFILE)
    assert found([0, 2.5, 5, 10, 20]).tolist() == [1, 2, 3, 2, 2]
    assert found.described["signal"] == "linear"
    held = signal('u = { profile = "p.csv", signal = "constant", high = 5 }\nx = [0, 1]')
    assert held([4.9, 5]).tolist() == [1, 3]
    # The rows are the campaign, and not the name of their file.
    rows = parsed("u = { profile = [[0, 1], [5, 3], [10, 2]] }\nx = [0, 1]")
    assert rows.digest == parsed(PROFILE).digest
    assert parsed("u = { profile = [[0, 1], [5, 3], [10, 2.5]] }\nx = [0, 1]").digest != rows.digest


def test_with_a_rate_the_parameters_are_shares() -> None:
    assert ends(RATE) == {"u_0": (0.0, 1.0), "u_share_1": (0.0, 1.0), "u_share_2": (0.0, 1.0)}
    # 10 s between knots, so that each is at most 0.5 from the one before.
    assert signal(RATE, 0.8, 0.0, 1.0).knots == pytest.approx((0.8, 0.3, 0.8))
    assert signal(RATE, 0.8, 1.0, 0.5).knots == pytest.approx((0.8, 1.0, 0.75))


@pytest.mark.parametrize("space", [SINE, STEP, PROFILE, RATE, TIMES, UNTIL, RATE.replace("linear", "pchip")])
@given(data=st.data())
def test_no_value_leaves_the_range_and_no_slope_the_rate(space: str, data: st.DataObject) -> None:
    config = parsed(space if "\nx" in space else f"{space}\nx = [0, 1]")
    assert isinstance(config.space, dict)
    boxes, given_range = parameter_ranges(config.space), config.space["u"]
    shares = data.draw(st.lists(st.integers(0, 10**9), min_size=len(boxes), max_size=len(boxes)))
    x = [each.low + (each.high - each.low) * k / 1e9 for k, each in zip(shares, boxes.values(), strict=True)]
    found = start_values(as_in_campaign(SPEC, config), x, config.horizon)["u"]
    assert isinstance(found, InputSignal)
    values = found(data.draw(st.lists(st.floats(-1, 30), min_size=1, max_size=4)))
    assert given_range.low <= values.min()
    assert values.max() <= given_range.high
    if given_range.rate is not None:
        points = list(zip(found.times, found.knots, strict=True))
        for (before, one), (at, other) in itertools.pairwise(points):
            assert abs(other - one) <= given_range.rate * (at - before) * (1 + 1e-12) + 1e-15


@given(first=st.floats(0, 1), steps=st.lists(st.floats(-1, 1), min_size=2, max_size=2))
def test_every_signal_within_the_rate_is_that_of_some_shares(first: float, steps: list[float]) -> None:
    knots = [first]
    for step in steps:
        knots.append(min(max(knots[-1] + 0.5 * step, 0.0), 1.0))
    shares = []
    for one, other in itertools.pairwise(knots):
        low, high = max(0.0, one - 0.5), min(1.0, one + 0.5)
        shares.append(min(max((other - low) / (high - low), 0.0), 1.0))
    assert signal(RATE, first, *shares).knots == pytest.approx(knots, abs=1e-9)


@pytest.mark.parametrize("space", FORMS)
def test_every_form_survives_json_and_toml(space: str) -> None:
    config = parsed(space)
    assert CampaignConfig.model_validate_json(config.model_dump_json()) == config
    table = json.loads(json.dumps(config.model_dump(mode="json", exclude_none=True)))
    again = parse_campaign(toml_file(_without_empty(table)).encode(), "c.toml")
    assert again == config
    assert again.digest == config.digest
    known = as_in_campaign(SPEC, parsed(f"{space}\nx = [0, 1]") if "\nx" not in space else config)
    template = RequestTemplate.of(known, {}, horizon=20.0, visual=False)
    x = [each.low for each in known.parameters]
    request = template.request(RolloutId("robustness", 0, "true", 0), x, 1)
    assert RolloutRequest.model_validate_json(request.model_dump_json()) == request
    assert SystemSpec.model_validate_json(known.model_dump_json()) == known


def _without_empty(table: Any) -> Any:
    return {key: each for key, each in table.items() if each not in ({}, [], None)}


@pytest.mark.parametrize(
    ("space", "words"),
    [
        (UNTIL.replace("10", "30"), "space.u.until: 30 horizon 20"),
        (TIMES.replace("20]", "21]"), "space.u.times: 21 horizon 20"),
        (STEP.replace("5,", "[5, 25],", 1), "space.u.at: 25 horizon 20"),
        (TIMES.replace("[0,", "[1,"), "space.u.times: 1 0"),
        (TIMES.replace("[0, 2,", "[0, 5,"), "space.u.times: 5 increase"),
        (TIMES.replace("low", "knots = 3, low"), "space.u.knots: 3 times 4"),
        (TIMES.replace("low", "until = 3, low"), "space.u.until: times"),
        (TIMES.replace("[0, 2, 5, 20]", "[]"), "space.u.times: 1 1,000"),
        (TIMES.replace("[0, 2, 5, 20]", "[0]").replace("constant", "linear"), "space.u.times: [0.0] 'linear' 2"),
        ("u = { times = [0, 1], low = 0, high = 1 }", 'space.u.times: "linear"'),
        (RATE.replace("linear", "constant"), "space.u.rate: 'constant' slope 'linear'"),
        (RATE.replace("0.05", "0"), "space.u.rate: 0 > 0"),
        (RATE.replace("rate", "step = 0.5, rate"), "space.u.step: rate"),
        (SINE.replace("amplitude = [0, 2], ", ""), "space.u.amplitude: required 'sine'"),
        (SINE.replace("[0, 2]", "[-2, 2]"), "space.u.amplitude: -2 0"),
        (SINE.replace("[0, 2]", "[2, 0]"), "space.u.amplitude.low: 2 0"),
        (SINE.replace("[0, 2]", '"x"'), "space.u.amplitude: 'x' [0, 5]"),
        (SINE.replace("unit", "low = -1, unit"), "space.u.low: -1 [-2, 2]"),
        (SINE.replace("unit", "high = 1, unit"), "space.u.high: 1 [-2, 2]"),
        (SINE.replace("unit", "knots = 3, unit"), "space.u.knots: 'sine' remove"),
        (SINE.replace("unit", "after = 3, unit"), "space.u.after: 'step' 'sine' remove"),
        (SINE.replace("unit", "step = 3, unit"), "space.u.step: 'sine' remove"),
        (SINE.replace("[0, 2]", '{ low = 0, high = 2, unit = "Hz" }'), "space.u.amplitude.unit: 'Hz' m"),
        (SINE.replace('signal = "sine", ', ""), 'space.u.amplitude: "sine"'),
        (STEP.replace("[15, 25]", "15"), "space: no parameter one start"),
        (PROFILE.replace("\nx = [0, 1]", ""), "space: no parameter one start"),
        (PROFILE.replace("p.csv", "wide.csv"), "space.u.profile: wide.csv: 3 t value"),
        (PROFILE.replace("p.csv", "swapped.csv"), "space.u.profile: swapped.csv: value,t"),
        (PROFILE.replace("p.csv", "late.csv"), "space.u.profile: 1"),
        (PROFILE.replace("p.csv", "double.csv"), "space.u.profile: 0 increase"),
        (PROFILE.replace("p.csv", "words.csv"), "space.u.profile: words.csv: '1,x'"),
        (PROFILE.replace("p.csv", "long.csv"), "space.u.profile: long.csv: 5,000"),
        (PROFILE.replace("p.csv", "no.csv"), "space.u.profile: no.csv: No such file"),
        (PROFILE.replace('"p.csv"', "3"), "space.u.profile: 3 CSV"),
        (PROFILE.replace('"p.csv"', '"p.csv", knots = 3'), "space.u.knots: profile remove"),
        (f"{SINE}\nu_amplitude = [0, 1]", "space.u_amplitude: another name"),
    ],
)
def test_what_is_refused(space: str, words: str) -> None:
    with pytest.raises(CampaignError) as error:
        parsed(space)
    assert "\n" not in str(error.value)
    assert says(str(error.value), words)


# Columns of signals that a formula names


def test_a_signal_that_a_formula_names_is_a_column_behind_those_of_the_system() -> None:
    config = parsed(f"{SINE}\nx = [0, 1]")
    known = as_in_campaign(SPEC, config)
    assert known.columns == (*SPEC.columns, Column(name="u", unit="m"))
    assert (known.recorded, known.own_columns) == (("u",), ("t", "v"))
    assert known.declared == SPEC
    check_against(config, known, "c.toml")
    ending = SPEC.with_said(None, "hold")
    assert [each.name for each in as_in_campaign(ending, config).columns] == ["t", "v", "u", "ended"]
    assert as_in_campaign(ending, config).own_columns == ("t", "v")


def test_a_column_of_the_system_stays_its_own() -> None:
    own = SPEC.model_copy(update={"columns": (*SPEC.columns, Column(name="u", unit="m"))})
    config = parsed(f"{SINE}\nx = [0, 1]")
    known = as_in_campaign(own, config)
    assert known.columns == own.columns
    assert known.recorded == ()


def test_a_signal_that_nothing_names_is_no_column() -> None:
    config = parse_campaign(f"{HEAD.replace('v - u', 'v')}{SINE}\nx = [0, 1]".encode(), "c.toml")
    assert as_in_campaign(SPEC, config).columns == SPEC.columns


@pytest.mark.rest
def test_editors_know_the_forms() -> None:
    schema = file_schema()
    for space in FORMS:
        table = tomllib.loads(HEAD + space)
        jsonschema.validate(table, schema)
        table["space"]["u"]["amplitudes"] = 1
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(table, schema)


def test_the_identity_of_other_campaigns_has_none_of_the_keys() -> None:
    config = parsed('u = { signal = "linear", knots = 2, low = 0, high = 1 }\nx = [0, 1]')
    space = config.model_dump(mode="json")["space"]
    assert space["u"].keys() == {"low", "high", "unit", "signal", "knots"}
    (shape,) = signal_shapes(config.space)
    assert shape.model_dump(mode="json") == {"name": "u", "kind": "linear", "knots": 2}

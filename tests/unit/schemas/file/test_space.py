"""`[space]` of a campaign file: short ranges, distributions, tables of starts, and which method takes which."""

import tomllib
from pathlib import Path
from typing import Any, get_args

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from perfbound.library.campaign import toml
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.defaults import file_schema
from perfbound.schemas.file.distributed import DISTRIBUTIONS
from perfbound.schemas.file.method_spaces import NEEDED, SPACES
from perfbound.schemas.file.parameters import Range
from perfbound.schemas.file.problem_models import PROBLEM_MODELS
from perfbound.schemas.file.reader import load_campaign, parse_campaign
from perfbound.schemas.file.space import (
    MAX_TABLE,
    Space,
    SpaceKind,
    StartTable,
    SystemChoice,
    space_kind,
)
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.values import DistributionName
from tests.facts import facts, says

ROOT = Path(__file__).parents[4]
HEAD = """specification = "v >= 0"
clip = [-1, 1]
alpha = 0.1
rkhs_norm = 2.0
noise_scale = 0.1
kernel = { length_scale = 1.0 }
system.name = "any"

[space]
"""
SPEC = SystemSpec(
    name="any",
    doc="",
    parameters=tuple(Parameter(name=name, unit="m", low=0.0, high=100.0) for name in ("gap", "speed")),
    columns=(Column(name="t", unit="s"), Column(name="v", unit="m")),
    max_horizon=10.0,
)
EXAMPLES: dict[DistributionName, str] = {
    "uniform": "",
    "normal": "mean = 20, sd = 5",
    "lognormal": "median = 20, sigma = 0.3",
    "triangular": "mode = 20",
    "weibull": "shape = 2, scale = 8",
}


def parsed(space: str, csv: bytes = b"") -> Any:
    return parse_campaign((HEAD + space).encode(), "c.toml", lambda _: csv)


def fault(space: str, csv: bytes = b"") -> str:
    with pytest.raises(CampaignError) as caught:
        parsed(space, csv)
    for message in caught.value.lines:
        assert "\n" not in message
        assert len(message) < 400
    message = caught.value.lines[0]
    return message.removeprefix("c.toml: ")


def ranged(distribution: str, keys: str, ends: str = "low = 5, high = 60") -> str:
    inside = ", ".join(filter(None, [ends, f'distribution = "{distribution}"', keys]))
    return f"gap = {{ {inside} }}\n"


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Method `rigorous` draws its starts: one row switches everything on."""
    monkeypatch.setitem(SPACES, "rigorous", get_args(SpaceKind))


# The short form


def test_the_short_form_is_the_same_campaign() -> None:
    one, other = (
        parsed("gap = [5, 60]\nspeed = [1.5, 2]"),
        parsed("gap = { low = 5, high = 60 }\nspeed = { low = 1.5, high = 2.0 }"),
    )
    assert one == other
    assert one.digest == other.digest
    assert one.model_dump_json() == other.model_dump_json()


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("[60, 5]", "^space.gap.low: 60 less high = 5"),
        ("[5, 5]", "^space.gap.low: 5 less high = 5"),
        ('["a", 5]', "^space.gap.low: 'a'"),
        ("[5, inf]", "^space.gap.high: inf"),
        ("[true, 5]", "^space.gap.low: True"),
        ("[5]", "^space.gap: [5] [0 5] table: { low"),
        ("[]", "^space.gap: [] [0 5]"),
        ("[5, 6, 7]", "^space.gap: [5 6 7] [0 5]"),
        ("[[5, 6], [7, 8]]", "^space.gap: [[5 6] [7 8]]"),
        ("5", "^space.gap: 5 [0 5]"),
        ('"5-60"', "^space.gap: '5-60' [0 5]"),
        ("{}", "^space.gap.low: required"),
        ("{ low = 5, hi = 6 }", "^space.gap.hi: unknown 'high'"),
    ],
)
def test_a_range_that_is_none(value: str, reason: str) -> None:
    assert says(fault(f"gap = {value}"), reason)


def test_a_space_that_is_none() -> None:
    text = HEAD.replace("[space]\n", "").replace("alpha", "space = [5, 60]\nalpha")
    with pytest.raises(CampaignError, match=facts("space: [5 60]")):
        parse_campaign(text.encode(), "c.toml")


@pytest.mark.parametrize(
    "space",
    [
        "gap = [5, 60]",
        "gap = { low = 5, high = 60 }\nspeed = [1, 2]",
        ranged("normal", "mean = 20, sd = 5"),
        "gap = { choices = [1, 2] }\nspeed = { low = 0, high = 4, step = 1 }",
        'table = "starts.csv"',
        "table = [[1, 2], [3, 4]]",
        "table = [5, 60]",
        'scenarios = "starts.csv"',
        "scenarios = [[1, 2], [3, 4]]",
    ],
)
def test_the_json_schema_takes_every_form(space: str) -> None:
    jsonschema.validate(tomllib.loads(HEAD + space), file_schema())


@pytest.mark.parametrize(
    "space", ["gap = [5]", 'gap = [5, "a"]', "gap = 5", "gap = { low = 1 }", "table = 5", "table = [[1, 2], 3]"]
)
def test_the_json_schema_refuses_other_forms(space: str) -> None:
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(HEAD + space), file_schema())


# Identity


DIGESTS = {
    "deploy/campaigns/segway-aggressive": "c3e9b5b804a1a799",
    "deploy/campaigns/segway-direct": "82ddcb13203d2408",
    "deploy/campaigns/segway-paper": "fd1391783912a967",
    "tests/fixtures/segway-pair": "f2009949019fc175",
    "deploy/campaigns/segway-scenario": "40e113a729f87b5b",
    "deploy/campaigns/test-function-rigorous": "6ae322dd2c7e6271",
    "deploy/campaigns/test-function": "8bb5c1c859284c1e",
    "deploy/examples/cars/cars": "f101c39f29f35b9c",
    "deploy/examples/cartpole/cartpole": "73f4d32151941100",
    "deploy/examples/pendulum/pendulum": "9ca9cb4ed16df842",
    "deploy/examples/pendulum/shell": "2e50eca709c6e1a8",
    "tests/fixtures/finished/paper": "7474140f122b0407",
    "tests/fixtures/finished/rigorous": "a3e25127ca525b7c",
    "tests/fixtures/finished/scenario": "c8d413e0a09ff3fd",
}


@pytest.mark.parametrize("name", DIGESTS)
def test_the_identity_of_a_file_stays(name: str) -> None:
    """Another digest is another campaign, with other seeds: it cannot be resumed."""
    assert load_campaign(ROOT / f"{name}.toml").digest[:16] == DIGESTS[name]


def test_no_distribution_is_uniform() -> None:
    assert parsed(ranged("uniform", "")) == parsed("gap = [5, 60]")
    assert '"distribution"' not in parsed("gap = [5, 60]").model_dump_json()


@pytest.mark.usefixtures("drawing")
def test_a_distribution_is_part_of_the_identity() -> None:
    texts = ["gap = [5, 60]", *(ranged(name, keys) for name, keys in EXAMPLES.items() if keys)]
    texts.append(ranged("normal", "mean = 20, sd = 6"))
    assert len({parsed(text).digest for text in texts}) == len(texts)
    assert (
        parsed(ranged("normal", "mean = 20, sd = 5.0")).digest == parsed(ranged("normal", "sd = 5, mean = 20")).digest
    )


# Distributions


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("name", get_args(DistributionName))
def test_each_distribution_is_described_by_its_keys(name: DistributionName) -> None:
    config = parsed(ranged(name, EXAMPLES[name]))
    assert set(config.space["gap"].described) == set(DISTRIBUTIONS[name])
    assert TypeAdapter(Space).validate_json(TypeAdapter(Space).dump_json(config.space)) == config.space
    check_against(parsed(ranged(name, EXAMPLES[name]) + "speed = [1, 2]"), SPEC, "c.toml")


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            ranged("gauss", ""),
            "^space.gap.distribution: 'gauss' 'uniform' 'normal'",
        ),
        ("gap = { low = 5, high = 60, distribution = 3 }", "^space.gap.distribution: 3"),
        (ranged("normal", ""), "^space.gap.mean: required 'normal' mean sd"),
        (ranged("normal", "mean = 20"), "^space.gap.sd: required 'normal' mean sd"),
        (ranged("lognormal", "sigma = 1"), "^space.gap.median: required 'lognormal' median sigma"),
        (ranged("triangular", ""), "^space.gap.mode: required 'triangular' mode"),
        (ranged("weibull", "scale = 1"), "^space.gap.shape: required 'weibull' shape scale"),
        (
            ranged("uniform", "mean = 20"),
            "^space.gap.mean: 'normal' 'uniform'",
        ),
        (
            ranged("normal", "mean = 20, sd = 5, mode = 3"),
            "^space.gap.mode: 'triangular'",
        ),
        (ranged("normal", "mean = 20, sd = 0"), "^space.gap.sd: 0 > 0"),
        (ranged("normal", "mean = 20, sd = -1"), "^space.gap.sd: -1 > 0"),
        (ranged("normal", "mean = 20, sd = inf"), "^space.gap.sd: inf > 0"),
        (ranged("normal", "mean = nan, sd = 1"), "^space.gap.mean: nan"),
        (ranged("normal", 'mean = "20", sd = 1'), "^space.gap.mean: '20'"),
        (ranged("normal", "mean = [20], sd = 1"), "^space.gap.mean: [20]"),
        (ranged("lognormal", "median = 0, sigma = 1"), "^space.gap.median: 0 > 0"),
        (ranged("lognormal", "median = 1, sigma = 0"), "^space.gap.sigma: 0 > 0"),
        (ranged("weibull", "shape = 0, scale = 1"), "^space.gap.shape: 0 > 0"),
        (ranged("weibull", "shape = 1, scale = 0"), "^space.gap.scale: 0 > 0"),
        (ranged("triangular", "mode = 4"), "^space.gap.mode: 4 [5 60]"),
        (ranged("triangular", "mode = 61"), "^space.gap.mode: 61 [5 60]"),
        (
            ranged("weibull", "shape = 2, scale = 8", "low = -1, high = 60"),
            "^space.gap.low: -1 'weibull'",
        ),
        (
            ranged("normal", "mean = 20, std = 1"),
            "^space.gap.std: unknown 'sd'",
        ),
        ("gap = { low = 0, high = 10, step = 0 }", "^space.gap.step: 0 > 0"),
        ("gap = { low = 0, high = 10, step = 3 }", "^space.gap.step: 3 high - low = 10"),
        (
            "gap = { low = 0, high = 10, step = 30 }",
            "^space.gap.step: 30 1 1,000,000",
        ),
        ("gap = { low = 0, high = 1, step = 1e-7 }", "^space.gap.step: 1e-07 1 1,000,000"),
        ("gap = { choices = 3 }", "^space.gap.choices: 3 2 1000"),
        ("gap = { choices = [3] }", "^space.gap.choices: [3] 2 1000"),
        ('gap = { choices = ["dry", 2] }', "^space.gap.choices.0: 'dry' 2 1000"),
        ("gap = { choices = [1, nan] }", "^space.gap.choices.1: nan 2 1000"),
        ("gap = { choices = [3, 4, 3.0] }", "^space.gap.choices: 3 twice"),
        ("gap = { choices = [3, 3] }", "^space.gap.choices: 3 twice"),
        ("gap = { choices = [3, 4], low = 2 }", "^space.gap.low: choices 3"),
        ("gap = { choices = [3, 4], step = 1 }", "^space.gap.choices: step"),
        (
            ranged("triangular", "mode = 3, choices = [5, 60]"),
            "^space.gap.choices:",
        ),
        ("gap = { distribution = 'normal', mean = 1, sd = 1 }", "^space.gap.low: required"),
    ],
)
def test_a_distribution_that_is_none(text: str, reason: str) -> None:
    assert says(fault(text), reason)


@pytest.mark.usefixtures("drawing")
def test_choices_are_a_range_with_their_ends() -> None:
    config = parsed("gap = { choices = [3, 1, 2.5] }\nspeed = { low = 0, high = 1, step = 0.1 }")
    assert (config.space["gap"].low, config.space["gap"].high) == (1.0, 3.0)
    assert config.space["speed"].steps == 10
    assert type(config).model_validate_json(config.model_dump_json()) == config
    assert config.digest != parsed("gap = { choices = [3, 1, 2] }\nspeed = { low = 0, high = 1, step = 0.1 }").digest
    check_against(config, SPEC, "c.toml")


# A table


@pytest.mark.usefixtures("drawing")
def test_a_table_is_read_as_scenarios_are_and_keeps_repeated_rows() -> None:
    config = parsed('table = "starts.csv"', b"gap,speed\r\n1,2\r\n\r\n3,4\r\n1,2\r\n")
    assert isinstance(config.space, StartTable)
    assert config.space.rows == ((1.0, 2.0), (3.0, 4.0), (1.0, 2.0))
    assert config.digest == parsed("table = [[1, 2], [3, 4], [1, 2]]").digest
    assert config.digest != parsed("table = [[1, 2], [3, 4]]").digest
    check_against(config, SPEC, "c.toml")


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize(
    ("space", "csv", "reason"),
    [
        ('table = "../a.csv"', b"", "^space.table: ../a.csv CSV"),
        ('table = "a.csv"', b"\xff\xfe", "^space.table: a.csv: UTF-8 CSV"),
        ('table = "a.csv"', b"", "^space.table: a.csv: 1 10,000"),
        ('table = "a.csv"', b"gap,speed\n", "^space.table: a.csv: 1 10,000"),
        (
            'table = "a.csv"',
            b"1,2O\n3,4\n",
            "^space.table: a.csv: 0 '1,2O'",
        ),
        # Python's `float` takes it, and a first row without any number passed for a header.
        ('table = "a.csv"', b"1_0,2_0\n3,4\n", "^space.table: a.csv: 0 '1_0,2_0'"),
        ('table = "a.csv"', b"1,2\n3,4_0\n", "^space.table: a.csv: 1 '3,4_0'"),
        ('table = "a.csv"', b"1,2\n3,\n", "^space.table: a.csv: 1 '3,'"),
        ('table = "a.csv"', b"1,2\n3,nan\n", "^space.table: a.csv: 1 '3,nan'"),
        (
            'table = "a.csv"',
            b"1,2\n3\n",
            "^space.table: 1 1 2",
        ),
        ('table = "a.csv"', b"1,2\n" * (MAX_TABLE + 1), "^space.table: a.csv: more 10,000"),
        ('table = "a.csv"', b'"' + b"1" * 200_000, "^space.table: a.csv: CSV: larger"),
        ("table = 5", b"", "^space.table: 5 CSV 1 10,000"),
        ("table = [[1, 2]]\nheader = 3", b"", "^space.header: 3"),
        ("table = [[1, 2]]\nheader = [3]", b"", "^space.header.0: 3"),
        ("table = []", b"", "^space.table: [] CSV 1 10,000"),
        ("table = [[]]", b"", "^space.table: 0 0 0"),
        ('table = [["a"]]', b"", "^space.table.0.0: 'a' CSV"),
        ('table = "a.csv"\ngap = [1, 2]', b"1,2\n", "^space.gap: space.table"),
        ("scenarios = [[1, 2]]\ngap = [1, 2]", b"", "^space.gap: space.scenarios"),
    ],
)
def test_a_table_that_is_none(space: str, csv: bytes, reason: str) -> None:
    assert says(fault(space, csv), reason)


@pytest.mark.usefixtures("drawing")
def test_a_table_of_another_system() -> None:
    for rows, reason in (
        ("[[1, 2, 3]]", r"space\.table: row 0 is \[1\.0, 2\.0, 3\.0\]; any takes gap, speed"),
        ("[[1, 2], [3, 400]]", r"space\.table: row 1, speed = 400 goes beyond \[0, 100\] m, the range of any"),
    ):
        with pytest.raises(CampaignError, match=f"c.toml: {reason}"):
            check_against(parsed(f"table = {rows}"), SPEC, "c.toml")


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("key", ["table", "scenarios"])
def test_a_header_that_exchanges_parameters_is_refused(key: str) -> None:
    text = f'method = "rigorous"\n{HEAD}{key} = "a.csv"'.encode()

    def read(header: bytes) -> Any:
        return parse_campaign(text, "c.toml", lambda _: header + b"1,2\n")

    for header in (b"speed,gap\n", b"speed,gap [m]\n", b"time, gap\n"):
        with pytest.raises(CampaignError, match=rf"space\.{key}: the header has \w+ in the column of \w+; sort the"):
            check_against(read(header), SPEC, "c.toml")
    for header in (b"gap,speed\n", b" gap , speed \n", b"gap [m],speed [m/s]\n", b"first,second\n", b"a\n"):
        check_against(read(header), SPEC, "c.toml")
        assert read(header).digest == read(b"").digest


def test_a_parameter_may_be_called_table() -> None:
    config = parsed("table = [5, 60]")
    assert config == parsed("table = { low = 5, high = 60 }")
    assert type(config).model_validate_json(config.model_dump_json()) == config


# Anything


VALUES = st.recursive(
    st.booleans() | st.integers(-3, 3) | st.floats() | st.sampled_from(["uniform", "normal", "a.csv", ""]),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["low", "high", "x"]), inner, max_size=3)
    ),
    max_leaves=6,
)
KEYS = [*Range.model_fields, "scenarios", "table"]


@pytest.mark.rest
@given(
    space=VALUES
    | st.dictionaries(
        st.sampled_from(["gap", "table", "scenarios", "kernel"]),
        VALUES | st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=5),
        max_size=3,
    )
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.usefixtures("drawing")
def test_any_value_is_a_space_or_a_line_for_each_fault(space: Any) -> None:
    text = toml({**tomllib.loads(HEAD), "space": space}, "here")
    found: Any = None
    try:
        found = parse_campaign(text.encode(), "c.toml", lambda _: b"1,2\n")
    except CampaignError as error:
        found = error.lines
    if isinstance(found, tuple):
        assert found
        assert all(len(line.splitlines()) == 1 for line in found)
    else:
        assert type(found).model_validate_json(found.model_dump_json()) == found


# Methods


def test_every_method_has_its_row() -> None:
    assert SPACES.keys() == PROBLEM_MODELS.keys()
    assert set(get_args(SpaceKind)) == NEEDED.keys()


def test_the_kind_of_a_space() -> None:
    spaces = {
        "box": {"gap": {"low": 0, "high": 1}},
        "distributions": {"gap": {"low": 0, "high": 1, "distribution": "triangular", "mode": 1}},
        "scenarios": {"scenarios": ((1.0,),)},
        "table": {"table": ((1.0,), (1.0,))},
    }
    assert {kind: space_kind(TypeAdapter(Space).validate_python(space)) for kind, space in spaces.items()} == {
        kind: kind for kind in get_args(SpaceKind)
    }


METHODS = {
    "paper": 'method = "paper"\nc = 0.1\nhorizon = 1\n',
    "rigorous": "horizon = 1\n",
    "scenario": 'method = "scenario"\n',
}


@pytest.mark.parametrize("method", METHODS)
def test_a_distribution_is_refused_where_nothing_is_drawn(method: str) -> None:
    kernel = ("rkhs_norm = 2.0\n", "noise_scale = 0.1\n", "kernel = { length_scale = 1.0 }\n")
    head = HEAD
    for key in kernel if method == "scenario" else ():
        head = head.replace(key, "")
    refused = f"not allowed with method {method!r}, which draws no starts; give"
    for space, reason in (
        (ranged("normal", "mean = 20, sd = 5"), f"space.gap.distribution: {refused} low and high alone"),
        ("gap = { low = 0, high = 4, step = 1 }", f"space.gap.step: {refused} low and high alone"),
        ("gap = { choices = [1, 2] }", f"space.gap.choices: {refused} low and high alone"),
        ("table = [[1, 2]]", f"space.table: {refused} a range per parameter or scenarios instead"),
    ):
        with pytest.raises(CampaignError) as caught:
            parse_campaign((METHODS[method] + head + space).encode(), "c.toml")
        assert str(caught.value) == f"c.toml: {reason}, or choose method 'sample'"


@pytest.mark.usefixtures("drawing")
def test_the_error_names_the_methods_that_draw() -> None:
    text = METHODS["paper"] + HEAD + ranged("normal", "mean = 20, sd = 5")
    with pytest.raises(CampaignError, match=facts("'rigorous' 'sample'")):
        parse_campaign(text.encode(), "c.toml")


@pytest.mark.usefixtures("drawing")
def test_a_method_that_draws_has_no_lattice_to_be_too_large() -> None:
    assert parsed("\n".join(f"x{k} = [0, 1]" for k in range(12))).space.keys() == {f"x{k}" for k in range(12)}


def test_a_worker_finds_an_installed_system_by_its_name_and_a_program_by_its_campaign_file(tmp_path: Path) -> None:
    program = SystemChoice(program=("./run",), columns={"v": "m"})
    file = tmp_path / "c.toml"
    assert SystemChoice(name="robot").reference(file) == "robot"
    assert program.reference(file) == str(file)

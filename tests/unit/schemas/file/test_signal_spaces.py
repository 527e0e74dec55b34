"""Input signals in `[space]` of a campaign file, and the check against their system."""

import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.defaults import file_schema
from perfbound.schemas.file.parameters import Range, parameter_ranges, signal_shapes
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.signals import SignalShape
from perfbound.schemas.file.space import space_kind
from perfbound.schemas.result.facts import Header
from perfbound.schemas.system import Column, Parameter, SystemSpec
from tests.facts import facts, says

HEAD = """specification = "v >= 0"
clip = [-1, 1]
alpha = 0.1
rkhs_norm = 2.0
noise_scale = 0.1
horizon = 4
kernel = { length_scale = LENGTH }
system.name = "any"

[space]
"""
HEAD_OF_SAMPLE = """specification = "always (v >= 0)"
method = "sample"
horizon = 20
system.name = "any"

[space]
"""
SIGNAL = 'u = { signal = "linear", knots = 2, low = 0, high = 1 }\n'
CONSTANT = 'gap = { signal = "constant", knots = 1, low = 0, high = 1 }\n'
SPEC = SystemSpec(
    name="any",
    doc="",
    parameters=(Parameter(0, 1, name="u", signal=True), Parameter(0, 9, name="gap", unit="m")),
    columns=(Column(name="t", unit="s"), Column(name="v", unit="m")),
    max_horizon=10.0,
)


def parsed(space: str, *, length: str = "1.0") -> Any:
    return parse_campaign((HEAD.replace("LENGTH", length) + space).encode(), "c.toml")


def fault(space: str, *, length: str = "1.0", spec: SystemSpec = SPEC) -> str:
    """Return the one line with which a campaign is refused."""
    with pytest.raises(CampaignError) as error:
        check_against(parsed(space, length=length), spec, "c.toml")
    assert "\n" not in str(error.value)
    return str(error.value)


def fault_of_space(space: str) -> str:
    if not space.startswith("scenarios"):
        return fault(space)
    text = 'specification = "v >= 0"\nclip = [-1, 1]\nalpha = 0.1\nhorizon = 4\nsystem.name = "any"\n[space]\n'
    with pytest.raises(CampaignError) as error:
        check_against(parse_campaign((text + space).encode(), "c.toml"), SPEC, "c.toml")
    return str(error.value)


def test_each_knot_is_a_parameter_with_the_range_of_the_signal() -> None:
    space = parsed(SIGNAL + "gap = [0, 9]").space
    assert signal_shapes(space) == (SignalShape(name="u", kind="linear", knots=2),)
    assert parameter_ranges(space) == {name: Range(low=0.0, high=1.0) for name in ("u_0", "u_1")} | {
        "gap": Range(low=0.0, high=9.0)
    }
    assert space_kind(space) == "box"


def test_knots_may_have_distributions_steps_and_choices() -> None:
    shape = {"signal": "constant", "knots": 3}
    for keys in ({"distribution": "normal", "mean": 0.5, "sd": 1.0}, {"step": 0.25}, {"choices": (0.0, 1.0)}):
        box = {"u": Range(low=0.0, high=1.0, **shape, **keys)}  # type: ignore[arg-type]
        assert space_kind(box) == "distributions"
        assert set(parameter_ranges(box).values()) == {Range(low=0.0, high=1.0, **keys)}


def test_the_header_of_a_campaign_has_the_knots() -> None:
    config = parsed(SIGNAL + "gap = [0, 9]")
    header = Header.new(config, SPEC, {})
    assert [each.name for each in header.spec.parameters] == ["u_0", "u_1", "gap"]
    assert header.system_sha256 == header.spec.digest == SPEC.digest
    check_against(config, header.spec, "c.toml")


def test_the_length_scale_of_a_signal_is_that_of_its_knots() -> None:
    (problem,) = parsed(SIGNAL + "gap = [0, 9]", length="{ u = 0.5, gap = 3 }").problems
    assert problem.kernel.length_scale == {"u_0": 0.5, "u_1": 0.5, "gap": 3.0}
    check_against(parsed(SIGNAL + "gap = [0, 9]", length="{ u_0 = 1, u_1 = 2, gap = 3 }"), SPEC, "c.toml")
    assert says(fault(SIGNAL + "gap = [0, 9]", length="{ gap = 3 }"), "kernel.length_scale: gap any: u_0 u_1 gap")


@pytest.mark.parametrize(
    ("space", "words"),
    [
        (SIGNAL.replace("2", "1"), "space.u.knots: required 'linear' >= 2"),
        ('u = { signal = "linear", low = 0, high = 1 }', "space.u.knots: required 'linear'"),
        ("u = { knots = 3, low = 0, high = 1 }", "space.u.knots: needs signal ="),
        ('u = { signal = "spline", knots = 3, low = 0, high = 1 }', "space.u.signal: 'spline' is not allowed"),
        ('u = { signal = "linear", knots = 2000, low = 0, high = 1 }', "space.u.knots: 2000 is not allowed"),
        ("u = [0, 1]\ngap = [0, 9]", "space.u.signal: required any u"),
        (SIGNAL + CONSTANT, "space.gap.signal: any gap signal"),
        (SIGNAL.replace("high = 1", "high = 2") + "gap = [0, 9]", "space.u: [0, 2] goes beyond [0, 1]"),
        ("scenarios = [[0, 1, 3]]", "space.scenarios: any u list"),
    ],
)
def test_what_is_refused(space: str, words: str) -> None:
    assert says(fault_of_space(space), words)


def test_a_signal_needs_a_horizon() -> None:
    text = HEAD.replace("LENGTH", "1.0").replace("horizon = 4\n", "") + SIGNAL + "gap = [0, 9]"
    with pytest.raises(CampaignError, match=facts("c.toml: space.u.signal: horizon signal knots")):
        parse_campaign(text.encode(), "c.toml")


def test_more_knots_than_a_start_has_room_for_are_refused() -> None:
    signals = "".join(SIGNAL.replace("u =", f"u{k} =").replace("2", "1000") for k in range(2)) + SIGNAL
    with pytest.raises(CampaignError, match=facts("^c.toml: space: 2002 more")):
        parse_campaign(f"{HEAD_OF_SAMPLE}{signals}".encode(), "c.toml")


@pytest.mark.rest
def test_editors_know_the_keys() -> None:
    example = Path(__file__).parents[4] / "deploy" / "examples" / "follow" / "follow.toml"
    table = tomllib.loads(example.read_text())
    jsonschema.validate(table, file_schema())
    for key, value in (("signal", "spline"), ("knots", 1.5)):
        wrong = {**table, "space": {**table["space"], "ahead": {**table["space"]["ahead"], key: value}}}
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, file_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**table, "space": {**table["space"], "where": 5}}, file_schema())


def test_a_stored_system_with_other_knots_is_refused() -> None:
    """The identity of a system does not depend on the knots, so nothing else finds a changed database."""
    config = parsed(SIGNAL + "gap = [0, 9]")
    for shapes in ((SignalShape(name="u", kind="pchip", knots=2),), (SignalShape(name="u", kind="linear", knots=3),)):
        with pytest.raises(CampaignError, match="its input signals are not those of the stored any"):
            check_against(config, SPEC.spread(shapes), "the campaign")


@given(keys=st.dictionaries(st.sampled_from(["signal", "knots"]), st.sampled_from(["linear", 0, 1, 2.5, True, [], {}])))
def test_any_signal_is_a_campaign_or_a_line_for_each_fault(keys: dict[str, Any]) -> None:
    values = ", ".join(f"{key} = {str(each).lower() if each is True else repr(each)}" for key, each in keys.items())
    refused: tuple[str, ...] = ()
    try:
        parsed(f"u = {{ low = 0, high = 1{', ' if values else ''}{values} }}", length="{ u = 1 }")
    except CampaignError as error:
        refused = error.lines
    assert not any("\n" in line for line in refused)

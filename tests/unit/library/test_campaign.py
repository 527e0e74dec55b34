"""Campaigns from Python: the same values, the same identity and the same errors as a campaign file."""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import perfbound as pb
from perfbound.library.campaign import toml
from perfbound.library.system_argument import given_system
from perfbound.schemas.errors import CampaignError, DefinitionError, PerfboundError
from perfbound.schemas.file.reader import load_campaign, parse_campaign
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.campaigns import FOLDER
from tests.facts import facts, says
from tests.patience import PATIENCE

pytestmark = pytest.mark.integration

CARS = Path(__file__).parents[3] / "deploy/examples/cars"
KERNEL = {"nu": 2.5, "length_scale": {"gap": 30, "speed": 20}}
AS_IN_THE_FILE: dict[str, Any] = {
    "space": {"gap": {"low": 20, "high": 50, "unit": "m"}, "speed": {"low": 10, "high": 30, "unit": "m/s"}},
    "options": {"reaction": 0.6},
    "horizon": 8.0,
    "specification": "always (distance >= 2)",
    "clip": (-20, 60),
    "max_tests": 60,
    "replicates": 8,
    "delta": 0.05,
    "alpha": 3.0,
    "rkhs_norm": np.float64(40),
    "prior_mean": -25,
    "noise_scale": 2.1,
    "kernel": KERNEL,
}
SMALL: dict[str, Any] = {"space": {"z1": (0, 5), "z2": (0, 5)}, "specification": "value <= 0.6"}
PROBLEM = {"delta": 0.05, "alpha": 0.1, "rkhs_norm": 2, "prior_mean": -0.6, "noise_scale": 0.01}
KEYS = {**SMALL, **PROBLEM, "clip": (-1, 2), "kernel": {"nu": 2.5, "length_scale": 1.0}}


@pytest.fixture(autouse=True)
def tests_importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """A child that loads this file as that of a system imports what it imports."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


@pytest.mark.rest
def test_the_identity_is_that_of_the_campaign_file() -> None:
    campaign, file = pb.Campaign(f"{CARS}/cars.py:cars", **AS_IN_THE_FILE), pb.Campaign.load(CARS / "cars.toml")
    assert campaign.config.digest == file.config.digest == load_campaign(CARS / "cars.toml").digest


@pytest.mark.rest
def test_load_takes_overrides() -> None:
    assert pb.Campaign.load(CARS / "cars.toml", seed=7).config.seed == 7


@pytest.mark.parametrize("name", sorted(path.name for path in FOLDER.glob("*.toml")))
def test_every_shipped_campaign_is_the_same_after_it_was_written(name: str) -> None:
    campaign = pb.Campaign.load(FOLDER / name)
    assert parse_campaign(campaign.to_toml().encode(), name) == campaign.config


@pytest.mark.rest
def test_a_saved_campaign_is_loaded_again(tmp_path: Path) -> None:
    campaign = pb.Campaign("test-function", **KEYS)
    assert pb.Campaign.load(campaign.save(tmp_path / "c.toml")).config == campaign.config


@pytest.mark.rest
def test_what_is_left_out_has_a_default() -> None:
    config = pb.Campaign("test-function", **KEYS).config
    assert (config.name, config.seed, config.composition) == ("test-function", 1, "single")
    assert [(each.name, each.method) for each in config.problems] == [("robustness", "rigorous")]
    listed = pb.Campaign(
        "test-function", **{**SMALL, "space": np.array([[1.0, 2.0], [2.0, 3.0]])}, clip=(-1, 1), delta=0.1, alpha=0.1
    )
    assert [each.method for each in listed.config.problems] == ["scenario"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"spezification": "value <= 1"}, "Campaign(test-function): spezification: unknown"),
        ({"alpha": None}, "Campaign(test-function): alpha: required"),
        ({"space": {"z1": (5, 0), "z2": (0, 5)}}, "space.z1.low: 5 less high = 0"),
        ({"space": {"z1": (0, 5)}}, "space.z2: test-function required"),
        ({"space": {"z1": (0, 9), "z2": (0, 5)}}, "space.z1: [0, 9] goes beyond [0, 5]"),
        ({"options": {"noise": 1}}, "system.noise: unknown key"),
        ({"specification": "velue <= 1"}, "Campaign(test-function): specification: "),
        ({"specification": object()}, "specification: object"),
        ({"rkhs_norm": float("nan")}, "Campaign(test-function): rkhs_norm: nan is"),
        (
            {**dict.fromkeys([*PROBLEM, "kernel"]), "problems": 3, "composition": "single"},
            "problems: 3",
        ),
        ({"problems": [{"name": "robustness"}], "alpha": 0.1}, "alpha: problem [[problems]]"),
    ],
)
def test_bad_arguments_are_lines_of_the_parser(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(CampaignError) as error:
        pb.Campaign("test-function", **{**KEYS, **changes})
    assert says(str(error.value), words)
    assert all(line.startswith("Campaign(test-function): ") and "\n" not in line for line in error.value.lines)


@pytest.mark.parametrize(
    ("system", "words"),
    [
        ("no-such", "Campaign(no-such): system: 'no-such'"),
        ("no/such.py:f", "there is no such Python file"),
        (print, "Campaign(print): system: builtin_function_or_method @perfbound.system"),
    ],
)
def test_a_system_that_is_none_is_refused(system: object, words: str) -> None:
    with pytest.raises(CampaignError) as error:
        pb.Campaign(system, **KEYS)
    assert says(str(error.value), words)


VALUES = st.recursive(
    st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.rest
@given(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=8), VALUES, max_size=5))
def test_every_table_is_read_as_it_was_written(table: dict[str, Any]) -> None:
    assert tomllib.loads(toml(table, "here")) == table


# Where a function is found


@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
def here(x: float) -> float:
    return x


@pytest.mark.rest
def test_a_function_in_a_file_is_found_there() -> None:
    found = given_system(here, "test")
    assert (found.reference, found.here) == (f"{__file__}:here", None)
    assert set(found.spec.code) >= {Path(__file__).name}


@pytest.mark.rest
def test_an_installed_system_is_found_by_its_name() -> None:
    found = given_system(TestFunctionSystem, "test")
    assert (found.choice, found.here) == ({"name": "test-function"}, None)
    assert found.spec.code, "as a worker has it"


def test_a_function_without_a_file_is_of_this_session() -> None:
    @pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
    def nested(x: float) -> float:
        return x

    found = given_system(nested, "test")
    assert found.here is nested
    assert found.spec.repeated == "session"
    assert list(found.spec.code) == ["nested (its own text)"]
    assert found.spec.digest != nested.spec.digest


@pytest.mark.rest
def test_another_function_of_the_same_name_in_the_file_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    @pb.system(parameters={"x": pb.Parameter(0, 2)}, columns={"y": ""})
    def here(x: float) -> float:
        return 2 * x

    monkeypatch.setitem(globals(), "here", here)
    found = given_system(here, "test")
    assert found.here is here
    assert found.reason == f"{__file__} defines another here"


SCRIPT = """
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
def f(x):
    return x

found = pb.Campaign(f, space={"x": (0, 1)}, specification="y <= 2", delta=.1, alpha=.1, rkhs_norm=2, noise_scale=0.0,
    kernel={"nu": 2.5, "length_scale": 1.0})
print(found._subject.reason)
"""


@pytest.mark.rest
def test_a_script_without_a_guard_begins_no_campaign_in_its_workers(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert says(ended.stdout, "`if __name__ == '__main__':`"), ended.stderr
    assert ended.returncode == 0


def test_a_file_that_begins_a_campaign_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perfbound.library.system_argument.loading", lambda: Path("a.py"))
    with pytest.raises(DefinitionError, match=facts("a.py: workers system pb")):
        pb.Campaign("test-function", **KEYS)


# Robustness


def test_robustness_of_columns_and_of_one_sample() -> None:
    assert pb.robustness("always (x <= 1)", {"t": [0, 1], "x": [0.25, 0.5]}) == 0.5
    assert pb.robustness("x <= 1", {"x": [0.25]}) == 0.75
    assert pb.robustness("x <= 1", pb.Trajectory(("t", "x"), np.array([[0.0, 3.0]]))) == -2


@pytest.mark.parametrize(
    ("formula", "columns", "words"),
    [
        ("always (y <= 1)", {"t": [0, 1], "x": [0, 1]}, "y"),
        ("always (x <= ", {"t": [0, 1], "x": [0, 1]}, "robustness: "),
        ("x <= 1", {"x": [0, 1]}, "samples without time"),
        ("x <= 1", {"t": [0], "x": [float("nan")]}, "not finite"),
    ],
)
def test_a_robustness_that_has_no_value_is_refused(formula: str, columns: dict[str, Any], words: str) -> None:
    with pytest.raises(PerfboundError) as error:
        pb.robustness(formula, columns)
    assert words in str(error.value)


# Representations, and what cannot be saved


def test_a_file_that_nothing_could_run_is_not_saved(tmp_path: Path) -> None:
    rig = pb.Rig("brake", parameters={"z1": pb.Parameter(0, 5)}, columns={"value": "m"}, noisy=False)
    campaign = pb.Campaign(
        rig, **{**KEYS, "space": {"z1": (0, 5)}, "noise_scale": 0.0, "kernel": {"length_scale": 1.0}}
    )
    with pytest.raises(CampaignError, match=facts("brake rig campaign file")):
        campaign.save(tmp_path / "c.toml")
    assert not (tmp_path / "c.toml").exists()


def test_a_trajectory_is_one_line_and_an_unknown_column_lists_the_known() -> None:
    found = Trajectory(("t", "angle"), np.array([[0.0, 1.0], [0.5, 2.0]]))
    assert says(repr(found), "^<Trajectory 2 0 to 0.5 s angle>")
    with pytest.raises(KeyError, match="no column 'angel'; there are t, angle"):
        found.column("angel")


@pytest.mark.rest
def test_a_campaign_of_several_requirements_shows_their_formulas() -> None:
    campaign = pb.Campaign(
        here,
        space={"x": (0, 1)},
        specifications={"low": "y >= 0", "high": "y <= 2"},
        alpha=0.1,
        rkhs_norm=2.0,
        noise_scale=0.0,
    )
    assert repr(campaign).endswith(": (y >= 0) and (y <= 2)>")


@pytest.mark.parametrize("limits", [("0", 1), (1,), (1, 2, 3), (0, float("nan")), (0, None), (True, [1])])
def test_a_parameter_without_two_numbers_is_one_line(limits: Any) -> None:
    with pytest.raises(PerfboundError, match=facts("Parameter(0, 5, unit='m')")) as error:
        pb.Parameter(*limits)
    assert "pydantic" not in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("model", "limits", "fields", "words"),
    [
        (
            pb.Parameter,
            (),
            {"low": "a", "high": 1},
            "Parameter(low='a', high=1): low: 'a'",
        ),
        (pb.Parameter, (), {"low": 0}, "Parameter(low=0): high two numbers"),
        (pb.Parameter, (0, 1), {"low": 0}, "not two limits"),
        (pb.Parameter, (5, 1), {}, "lower 5 above 1 exchange"),
        (pb.Parameter, (0, 1), {"units": "m"}, "Parameter units name unit low high signal"),
        (pb.Column, ("x", "m"), {}, "give the fields of Column by their names"),
        (pb.Column, (), {"name": "X", "unit": "m"}, "name: 'X': a-z 0-9 _"),
        (pb.Option, (), {"default": 1.0}, "Option needs name"),
        (pb.SystemSpec, (), {"name": "a_b"}, "name: 'a_b': a-z 0-9 -"),
        (pb.SystemSpec, (), {"name": "a"}, "SystemSpec needs doc"),
    ],
)
def test_what_is_written_in_python_is_refused_in_one_line(
    model: Callable[..., object], limits: tuple[Any, ...], fields: dict[str, Any], words: str
) -> None:
    with pytest.raises(PerfboundError, match=facts(words)) as error:
        model(*limits, **fields)
    assert "pydantic" not in str(error.value)
    assert "\n" not in str(error.value)

"""FMUs as systems: what follows from the model description, what a rollout is, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import CampaignError, DefinitionError, ReplacedError, SimulationError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.trajectory.input_signal import InputSignal
from perfbound.workers.systems.base import Cancelled, SystemUnderTest
from perfbound.workers.systems.fmu import load_fmu
from tests.fakes.fmus import COMPILER, INTERFACES, NO_COMPILER, SOURCE, written

pytestmark = [pytest.mark.integration, pytest.mark.skipif(COMPILER is None, reason=NO_COMPILER)]
CAMPAIGN = """
specification = "always (SIGNAL <= 2)"
horizon = 10
falsify = {}
max_tests = 10
[system]
fmu = "Tank.fmu"
KEYS
[space]
SPACE
"""
LEVEL = "tank_level0 = [0.5, 1.5]"
Make = Callable[..., SystemUnderTest]


@pytest.fixture
def tank(tmp_path: Path) -> Make:
    """Make a system of a campaign file beside an FMU."""

    def make(
        keys: str = "step = 0.1",
        space: str = LEVEL,
        *interfaces: str,
        fmi: int = 2,
        signal: str = "tank_level",
        **how: Any,
    ) -> SystemUnderTest:
        written(tmp_path / "Tank.fmu", fmi, *interfaces, **how)
        return load(tmp_path, keys, space, signal)

    return make


def load(folder: Path, keys: str = "step = 0.1", space: str = LEVEL, signal: str = "tank_level") -> SystemUnderTest:
    text = CAMPAIGN.replace("SIGNAL", signal).replace("KEYS", keys).replace("SPACE", space)
    return load_fmu(folder / "c.toml", parse_campaign(text.encode(), "c.toml"))


def rolled(
    system: SystemUnderTest, *x: Any, seed: int = 7, horizon: float = 10.0, progress: Any = lambda _: None
) -> Any:
    return system.rollout(x, variant="nominal", seed=seed, horizon=horizon, options={}, progress=progress)


def drained(level: float, horizon: float = 10.0, inflow: Callable[[float], float] = lambda t: 0.1) -> float:
    """Return the last level, by small steps."""
    step = 1e-4
    for k in range(round(horizon / step)):
        level += step * (inflow(k * step) - 0.2 * max(level, 0.0) ** 0.5)
    return level


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_start_values_outputs_and_units_are_those_of_the_model_description(
    tank: Make, fmi: int, interface: str
) -> None:
    system = tank("step = 0.1", LEVEL, interface, fmi=fmi)
    spec = system.spec
    assert [(each.name, each.low, each.high, each.unit) for each in spec.parameters] == [("tank_level0", 0.5, 1.5, "m")]
    assert [(each.name, each.unit) for each in spec.columns] == [("t", "s"), ("tank_level", "m")]
    assert spec.doc == f"Tank.fmu, {interface} of FMI {fmi}.0 with a step of 0.1 s"
    assert set(spec.code) == {"Tank.fmu"}
    assert {"FMPy", "numpy"} <= set(spec.versions)
    assert (spec.noisy, spec.variants) == ((), ("nominal",))
    found = rolled(system, 1.2)
    assert np.allclose(found.column("t"), 0.1 * np.arange(101), rtol=0, atol=1e-12)
    assert found.column("tank_level")[0] == 1.2
    assert found.column("tank_level")[-1] == pytest.approx(drained(1.2), abs=1e-3)
    assert np.array_equal(rolled(system, 1.2).samples, found.samples), "nothing is left of a rollout"
    assert not np.array_equal(rolled(system, 1.3).samples, found.samples)


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_unit_that_terminates_ends_its_rollout(tank: Make, fmi: int, interface: str) -> None:
    keys = 'step = 0.1\nlimit = 1.5\nleak = 0.0\nafter_end = "hold"'
    system = tank(keys, LEVEL, interface, fmi=fmi)
    found = rolled(system, 1.2)
    assert system.spec.columns[-1].name == "ended"
    assert 28 <= len(found.samples) <= 32, "3 s for 0.3 m at 0.1 m/s"
    assert found.column("tank_level")[-1] == pytest.approx(1.5, abs=0.02)
    assert len(rolled(system, 0.1 + 0.4, horizon=5.0).samples) == 51


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("kind", ["linear", "constant", "pchip"])
def test_an_input_follows_its_signal(tank: Make, interface: str, kind: Any) -> None:
    system = tank("step = 0.01", LEVEL + "\ninflow = { low = 0, high = 1, signal = 'linear', knots = 4 }", interface)
    signal = InputSignal(kind, (0.0, 1.0, 0.2, 0.5), 10.0)
    found = rolled(system, 1.0, signal)
    assert found.column("tank_level")[-1] == pytest.approx(drained(1.0, inflow=signal), abs=5e-3)
    without = rolled(tank("step = 0.01", LEVEL, interface), 1.0)
    assert abs(found.column("tank_level")[-1] - without.column("tank_level")[-1]) > 0.5


def test_integers_switches_and_tunable_values_are_set_as_what_they_are(tank: Make) -> None:
    space = LEVEL + "\nstages = { low = 1, high = 3, step = 1 }\nopen = { low = 0, high = 1, choices = [0, 1] }"
    system = tank("step = 0.1\ninflow = 0.0\nleak = 0.1", space)
    closed, one, three = (rolled(system, 1.0, *x).column("tank_level")[-1] for x in ((1, 0), (1, 1), (3, 1)))
    assert closed == 1.0
    assert three < one < closed


def test_an_unlike_seed_is_the_value_of_the_variable_seed(tank: Make) -> None:
    system = tank("step = 0.1\nnoisy = true")
    assert system.spec.noisy == ("nominal",)
    assert rolled(system, 1.0, seed=3).column("tank_level")[0] == 4.0
    assert rolled(system, 1.0, seed=7).column("tank_level")[0] == 1.0


def test_other_variables_are_columns_by_name(tank: Make) -> None:
    found = rolled(tank('step = 0.1\ncolumns = { der_level = "", tank_level = "m" }', signal="der_level"), 1.0)
    rate, level = found.column("der_level"), found.column("tank_level")
    assert rate == pytest.approx(0.1 - 0.2 * np.sqrt(level))


def test_without_a_step_it_is_that_of_the_experiment(tank: Make) -> None:
    assert rolled(tank("", step=0.25), 1.0).samples.shape == (41, 2)


def test_what_a_unit_says_of_its_failure_stands_in_the_error(tank: Make) -> None:
    system = tank("step = 0.1\nleak = 0", "inflow = [0, 9]")
    with pytest.raises(
        SimulationError, match=r"^after t = 1\.7 s: fmi2DoStep failed with status 3 \(error\); the tank of 10 m is full"
    ):
        rolled(system, 5.0)
    assert len(rolled(system, 0.5).samples) == 101, "and the next rollout is not concerned"
    with pytest.raises(SimulationError, match=r"fmi3DoStep.*the tank of 10 m is full"):
        rolled(tank("step = 0.1\nleak = 0", "inflow = [0, 9]", fmi=3), 5.0)


def test_a_rollout_can_be_cancelled(tank: Make) -> None:
    system = tank()

    def progress(step: int) -> None:
        if step == 5:
            raise Cancelled

    with pytest.raises(Cancelled):
        rolled(system, 1.0, progress=progress)
    assert len(rolled(system, 1.0).samples) == 101


def test_a_replaced_unit_is_refused_by_its_name(tank: Make, tmp_path: Path) -> None:
    system = tank()
    before = system.spec.code
    written(tmp_path / "Tank.fmu", 2, source=SOURCE.read_text().replace("[LEAK] = 0.2", "[LEAK] = 0.3"))
    with pytest.raises(ReplacedError, match=r"Tank\.fmu"):
        rolled(system, 1.0)
    assert load(tmp_path).spec.code != before


@pytest.mark.parametrize(
    ("keys", "space", "message"),
    [
        ("", LEVEL, "system.step: Tank.fmu does not say how often"),
        ("step = 20", LEVEL, "horizon: 10 s is less than one step"),
        ("step = 3", LEVEL, "horizon: of steps of 3 s the last one before 10 s ends at 9 s; give horizon = 9"),
        ("step = 0.1", "tank_lvel0 = [0, 1]", "did you mean 'tank_level0'.*no variable 'tank_lvel0'"),
        ("step = 0.1", "tank_level = [0, 1]", r"Tank\.level is calculated by Tank\.fmu, and no start value"),
        ("step = 0.1", "tank_level0 = { low = 0, high = 1, unit = 'cm' }", "is in m, says the FMU, and not in cm"),
        ("step = 0.1", "tank_level0 = [-1, 1]", r"\[-1, 1\] goes beyond \[0, 20\]"),
        ("step = 0.1", "stages = [1, 3]", "stages is an integer of the FMU; write stages"),
        (
            "step = 0.1",
            "leak = { low = 0, high = 1, signal = 'linear', knots = 4 }",
            "leak is no input of numbers over time",
        ),
        ("step = 0.1\ncolumns = { levl = 'm' }", LEVEL, "system.columns: .*no variable 'levl'"),
        ("step = 0.1\ncolumns = { tank_level = 'cm' }", LEVEL, "is in m, says the FMU, and not in cm"),
        ("step = 0.1\nintrface = 'co-simulation'", LEVEL, "did you mean 'interface'"),
        ("step = 0.1\nleak = 'much'", LEVEL, "system.leak: 'much' is no value of a Real; give a number"),
        ("step = 0.1\nopen = 7", LEVEL, "system.open: 7 is not allowed; give 0 or 1"),
        ("step = 0.1\nstages = 2.5", LEVEL, r"system.stages: 2\.5 is not allowed; give a whole number"),
        ("step = 0.1\ntank_level0 = 21.0", "leak = [0, 1]", "system.tank_level0: 21 .*; give a number from 0 to 20"),
        ("step = 0.1\nmax_tests = 3", LEVEL, "system: put the key `max_tests` of the campaign above the first"),
        ("step = 0.1", "Tank_level0 = [0, 1]", "space: names are in lower case here; write tank_level0 for"),
        ("step = 0.1\ntank_level0 = 1.0", LEVEL, "is a parameter of .space., too"),
    ],
)
def test_a_name_or_number_that_cannot_be_is_refused_with_its_place(
    tank: Make, keys: str, space: str, message: str
) -> None:
    with pytest.raises(DefinitionError, match=f"c.toml: (space: |horizon: |system.*)?.*{message}"):
        tank(keys, space)


def test_files_that_are_no_unit_are_refused(tank: Make, tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match=r"system.fmu: Tank\.fmu: there is no such file"):
        load(tmp_path)
    (tmp_path / "Tank.fmu").write_bytes(b"no archive")
    with pytest.raises(DefinitionError, match=r"system.fmu: Tank\.fmu: this file is no FMU"):
        load(tmp_path)
    with pytest.raises(DefinitionError, match="it is built for win64, and this is"):
        tank(platform=("win64", "win64"))
    with pytest.raises(DefinitionError, match="has model-exchange alone"):
        tank('step = 0.1\ninterface = "co-simulation"', LEVEL, "model-exchange")
    with pytest.raises(DefinitionError, match=r"Tank\.fmu: .*fmi2Instantiate"):
        tank(source=SOURCE.read_text().replace("*fmi2Instantiate", "*fmi2Instntiate"))


def test_keys_of_other_systems_are_refused() -> None:
    text = CAMPAIGN.replace("SIGNAL", "tank_level").replace("KEYS", 'policy = "p.py:act"').replace("SPACE", LEVEL)
    with pytest.raises(CampaignError, match="policy: this key is for an environment of Gymnasium alone"):
        parse_campaign(text.encode(), "c.toml")

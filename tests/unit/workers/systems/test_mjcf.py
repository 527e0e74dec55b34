"""Models for MuJoCo as systems: their names and units, what a rollout is, and what is refused."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from perfbound.schemas.errors import DefinitionError, ReplacedError, SimulationError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.system_check import Acts
from perfbound.schemas.trajectory.input_signal import InputSignal
from perfbound.workers.systems.base import SystemUnderTest
from perfbound.workers.systems.mjcf import load_mjcf

MODEL = """
<mujoco>
  <option timestep="0.005" integrator="INTEGRATOR"/>
  <include file="pole.xml"/>
  <actuator><motor name="Motor" joint="hinge" ctrlrange="-3 3"/></actuator>
  <sensor>
    <jointpos name="Tip angle" joint="hinge"/><actuatorfrc name="torque" actuator="Motor"/>
    <accelerometer name="felt" site="tip"/>
  </sensor>
  <keyframe><key name="tilted" qpos="0.2" qvel="0.1"/></keyframe>
</mujoco>
"""
POLE = """
<mujoco><worldbody>
  <body pos="0 0 1">
    <joint name="hinge" axis="0 1 0" damping="0.1"/>
    <geom name="rod" type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="1"/><site name="tip" pos="0 0 0.5"/>
  </body>
</worldbody></mujoco>
"""
BALANCE = "def balance(model, data):\n    return [-12 * data.qpos[0] - 2 * data.qvel[0]]\n"
CAMPAIGN = """
specification = "always (SIGNAL <= 1)"
horizon = 1
falsify = {}
max_tests = 10
[system]
mjcf = "pendulum.xml"
KEYS
[space]
SPACE
"""
START = "qpos_hinge = [-0.5, 0.5]\nqvel_hinge = [-1, 1]"
CONTROLLED = 'controller = "control.py:balance"'
Make = Callable[..., SystemUnderTest]


@pytest.fixture
def pendulum(tmp_path: Path) -> Make:
    """Make a system of a campaign file beside a model in two files, and a controller."""

    def make(
        keys: str = "",
        space: str = START,
        *,
        signal: str = "tip_angle",
        control: str = BALANCE,
        integrator: str = "Euler",
        model: str = MODEL,
    ) -> SystemUnderTest:
        (tmp_path / "pendulum.xml").write_text(model.replace("INTEGRATOR", integrator))
        (tmp_path / "pole.xml").write_text(POLE)
        (tmp_path / "control.py").write_text(control)
        text = CAMPAIGN.replace("SIGNAL", signal).replace("KEYS", keys).replace("SPACE", space)
        return load_mjcf(tmp_path / "c.toml", parse_campaign(text.encode(), "c.toml"))

    return make


def rolled(system: SystemUnderTest, *x: Any, seed: int = 7, horizon: float = 1.0) -> Any:
    return system.rollout(x, variant="nominal", seed=seed, horizon=horizon, options={}, progress=lambda _: None)


def stepped(folder: Path, x: tuple[float, float], steps: int, *, controlled: bool) -> Any:
    """Return angle, torque and acceleration of each time as a plain loop of MuJoCo has them."""
    model = mujoco.MjModel.from_xml_path(str(folder / "pendulum.xml"))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = x
    rows = []
    for k in range(steps + 1):
        if controlled and k % 2 == 0:
            data.ctrl[0] = -12 * data.qpos[0] - 2 * data.qvel[0]
        mujoco.mj_forward(model, data)
        rows.append(data.sensordata.copy())
        mujoco.mj_step(model, data)
    return np.array(rows)


def test_names_and_units_are_those_of_the_model(pendulum: Make) -> None:
    spec = pendulum(CONTROLLED + "\nstep = 0.01").spec
    parameters = [(each.name, each.low, each.high, each.unit) for each in spec.parameters]
    assert parameters == [("qpos_hinge", -0.5, 0.5, "rad"), ("qvel_hinge", -1.0, 1.0, "rad/s")]
    assert {each.name: each.unit for each in spec.columns} == {
        "t": "s",
        "tip_angle": "rad",
        "torque": "",
        "felt_0": "m/s2",
        "felt_1": "m/s2",
        "felt_2": "m/s2",
    }
    assert set(spec.code) == {"pendulum.xml", "pole.xml", "control.py"}
    assert "mujoco" in spec.versions
    assert (spec.noisy, spec.default_horizon) == ((), 1.0)
    assert "recorded every 0.01 s, with control.py:balance" in spec.doc


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("controlled", [False, True])
def test_a_rollout_is_that_of_mujoco_and_sensors_are_those_of_their_time(
    pendulum: Make, tmp_path: Path, integrator: str, controlled: bool
) -> None:
    system = pendulum(f"step = 0.01\n{CONTROLLED if controlled else ''}", integrator=integrator)
    found = rolled(system, 0.4, -0.2)
    expected = stepped(tmp_path, (0.4, -0.2), 200, controlled=controlled)[::2]
    assert np.allclose(found.samples[:, 1:], expected, rtol=0, atol=1e-12)
    assert np.allclose(found.column("t"), 0.01 * np.arange(101), rtol=0, atol=1e-12)
    rolled(system, -0.4, 0.7)
    assert np.array_equal(rolled(system, 0.4, -0.2).samples, found.samples), "nothing is left of a rollout"


def test_an_actuator_is_a_parameter_or_an_input_over_time(pendulum: Make) -> None:
    fixed = rolled(pendulum("", "ctrl_motor = [-2, 2]", signal="torque"), 1.5)
    assert set(fixed.column("torque")) == {1.5}
    system = pendulum("", "ctrl_0 = { low = -2, high = 2, signal = 'linear', knots = 3 }", signal="torque")
    torque = rolled(system, InputSignal("linear", (0.0, 2.0, -1.0), 1.0)).column("torque")
    assert torque[[0, 50, 100, 150, 200]] == pytest.approx([0.0, 1.0, 2.0, 0.5, -1.0])


def test_a_start_begins_at_a_keyframe_and_columns_may_be_chosen(pendulum: Make) -> None:
    system = pendulum(
        'keyframe = "tilted"\ncolumns = { qpos_hinge = "", qvel_0 = "" }', "ctrl_motor = [0, 1]", signal="qvel_0"
    )
    assert rolled(system, 0.0).samples[0].tolist() == [0.0, 0.2, 0.1]
    assert [each.unit for each in system.spec.columns] == ["s", "rad", "rad/s"]


def test_without_sensors_the_joints_are_the_columns(pendulum: Make) -> None:
    system = pendulum(model=MODEL[: MODEL.index("<sensor>")] + "</mujoco>", signal="qpos_hinge")
    assert [each.name for each in system.spec.columns] == ["t", "qpos_hinge", "qvel_hinge"]


def test_a_function_reset_sets_what_has_no_name_and_leaves_nothing_behind(pendulum: Make) -> None:
    control = BALANCE + (
        "\ndef reset(model, data, *, mass, seed):\n"
        "    model.body_mass[1] = mass\n    data.qpos[0] = 0.1 + (seed % 7) / 10\n"
    )
    system = pendulum(CONTROLLED, "mass = [0.5, 2]", control=control)
    assert system.spec.noisy == ("nominal",)
    light, heavy = rolled(system, 0.5), rolled(system, 2.0)
    assert light.column("tip_angle")[0] == 0.1
    assert not np.array_equal(light.samples, heavy.samples)
    assert np.array_equal(rolled(system, 0.5).samples, light.samples)
    assert rolled(system, 0.5, seed=3).column("tip_angle")[0] == pytest.approx(0.4)


def test_a_controller_may_set_the_actuators_itself_and_have_a_memory(pendulum: Make) -> None:
    control = (
        "class balance:\n    def reset(self):\n        self.calls = 0\n"
        "    def __call__(self, model, data):\n        self.calls += 1\n        data.ctrl[0] = self.calls / 1000\n"
    )
    system = pendulum(CONTROLLED, control=control)
    rolled(system, 0.0, 0.0)
    assert rolled(system, 0.0, 0.0).column("torque")[[0, 200]] == pytest.approx([0.001, 0.201])


def test_a_simulation_that_is_not_stable_is_no_rollout(pendulum: Make, tmp_path: Path) -> None:
    model = MODEL.replace('ctrlrange="-3 3"', 'gear="1e9"')
    system = pendulum("", "ctrl_motor = [-1e9, 1e9]", model=model)
    with pytest.raises(SimulationError, match=r"MuJoCo: Nan, Inf or huge value in Q\w+ .*after t = 0"):
        rolled(system, 1e9)
    assert len(rolled(system, 0.0).samples) == 201, "and the next rollout is not concerned"
    assert not list(tmp_path.glob("MUJOCO_LOG*"))


@pytest.mark.parametrize("name", ["pole.xml", "pendulum.xml"])
def test_a_replaced_file_of_the_model_is_refused_by_its_name(pendulum: Make, tmp_path: Path, name: str) -> None:
    system = pendulum()
    before = system.spec.code
    file = tmp_path / name
    file.write_text(file.read_text() + "\n")
    with pytest.raises(ReplacedError, match=name):
        rolled(system, 0.0, 0.0)
    assert system.spec.code == before
    assert load_mjcf(tmp_path / "c.toml", _parsed(CAMPAIGN)).spec.code != before


def _parsed(campaign: str) -> Any:
    text = campaign.replace("SIGNAL", "tip_angle").replace("KEYS", "").replace("SPACE", START)
    return parse_campaign(text.encode(), "c.toml")


@pytest.mark.parametrize(
    ("keys", "space", "message"),
    [
        ("step = 0.007", START, "system.step: 0.007 s is no multiple of the model's time step, 0.005 s; give 0.005,"),
        ("step = 2", START, "horizon: 1 s is less than one step"),
        ("", "qpos_hing = [0, 1]", "space: did you mean 'qpos_hinge'.*'qpos_hing' is none of.*reset"),
        ("", "tip_angle = [0, 1]", "space: .*'tip_angle' is none of"),
        ("", "qpos_hinge = { low = 0, high = 1, signal = 'linear', knots = 3 }", "space: qpos_hinge is no actuator"),
        ("columns = { tip_angl = '' }", START, "system.columns: did you mean 'tip_angle'"),
        ("columns = { tip_angle = 'deg' }", START, "system.columns: tip_angle is in rad, and not in deg"),
        ('keyframe = "tlted"', START, "system.keyframe: 'tlted' is none of tilted"),
        ("stp = 0.01", START, "system: did you mean 'step'"),
        ("max_tests = 3", START, "system: put the key `max_tests` of the campaign above the first"),
        (
            "",
            "qpos_hinge = { low = -1, high = 1, unit = 'deg' }",
            r"space: qpos_hinge is in rad, and not in deg; give \[-0.0174533, 0.01",
        ),
        ("", "qpos_Hinge = [0, 1]", "space: names are in lower case here; write qpos_hinge for 'qpos_Hinge'"),
        ('controller = "control.py:balance"', "ctrl_motor = [0, 1]", "space: ctrl_motor is set by the controller"),
        ('controller = "control.py:balanced"', START, "system.controller: .*did you mean 'balance'"),
        ('controller = "control.py:blance"', START, "system.controller: .*no function 'blance'.*model, data"),
        ('controller = "cntrol.py:balance"', START, "system.controller: .*no such Python file"),
    ],
)
def test_a_name_that_cannot_be_is_refused_with_its_place(pendulum: Make, keys: str, space: str, message: str) -> None:
    with pytest.raises(DefinitionError, match=f"c.toml: {message}"):
        pendulum(keys, space)


def test_a_reset_without_a_parameter_is_refused(pendulum: Make) -> None:
    with pytest.raises(
        DefinitionError,
        match=r"reset in control\.py sets the first state, and has no argument 'qvel_hinge'; write def reset",
    ):
        pendulum(CONTROLLED, control=BALANCE + "\ndef reset(model, data, *, qpos_hinge):\n    pass\n")


def test_a_reset_whose_argument_has_no_range_is_refused(pendulum: Make) -> None:
    control = BALANCE + "\ndef reset(model, data, *, mass, slope, seed, wind=0):\n    pass\n"
    with pytest.raises(DefinitionError, match=r"slope has no range, and the function reset in control\.py takes it"):
        pendulum(CONTROLLED, "mass = [1, 2]", control=control)


def test_a_start_beyond_the_range_of_its_joint_is_refused(pendulum: Make, tmp_path: Path) -> None:
    limited = POLE.replace('axis="0 1 0"', 'axis="0 1 0" limited="true" range="-20 20"')
    model = MODEL.replace('<include file="pole.xml"/>', limited.replace("<mujoco>", "").replace("</mujoco>", ""))
    with pytest.raises(DefinitionError, match=r"qpos_hinge = \[-0\.5, 0\.5\] goes beyond \[-0\.349066, 0\.349066\]"):
        pendulum(model=model)


@pytest.mark.parametrize(
    ("control", "message"),
    [
        (
            "class balance:\n    def __init__(self, model): pass\n",
            r"control\.py: balance\(\) without arguments: TypeError",
        ),
        ("class balance:\n    pass\n", r"control\.py: balance cannot be called; give it def __call__"),
        ("def balance(observation): pass\n", r"control\.py: balance is called with \(model, data\): too many"),
    ],
)
def test_a_controller_that_cannot_be_called_is_refused(pendulum: Make, control: str, message: str) -> None:
    with pytest.raises(DefinitionError, match=f"system.controller: .*{message}"):
        pendulum(CONTROLLED, control=control)


@pytest.mark.parametrize("returned", ["[1.0, 2.0]", "'left'", "[float('nan')]"])
def test_what_is_no_value_of_the_actuators_is_refused(pendulum: Make, returned: str) -> None:
    system = pendulum(CONTROLLED, control=f"def balance(model, data):\n    return {returned}\n")
    with pytest.raises(SimulationError, match=r"control\.py (returned|gives an actuator)"):
        rolled(system, 0.0, 0.0)


def test_models_that_cannot_be_read_are_refused_with_the_reason(pendulum: Make, tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match=r"system.mjcf: pendulum\.xml: ValueError: .*Schema violation"):
        pendulum(model="<mujoco><wrldbody/></mujoco>")
    (tmp_path / "pendulum.xml").unlink()
    with pytest.raises(
        DefinitionError, match=r"pendulum\.xml: there is no such file in .*; did you mean 'pole.xml'\?$"
    ):
        load_mjcf(tmp_path / "c.toml", _parsed(CAMPAIGN))


@pytest.mark.parametrize(
    ("control", "idle"),
    [
        (BALANCE.replace("return [", "force = ["), True),
        (BALANCE.replace("return [", "data.ctrl[:] = ["), False),
        (BALANCE.replace("return [-12 * data.qpos[0] - 2 * data.qvel[0]]", "data.qfrc_applied[0] = -1"), False),
        (BALANCE, False),
        (BALANCE.replace("-12 * data.qpos[0] - 2 * data.qvel[0]", "0"), False),
    ],
)
def test_a_controller_that_sets_nothing_is_reported_to_the_check(pendulum: Make, control: str, idle: bool) -> None:
    system = pendulum(CONTROLLED, control=control)
    rolled(system, 0.2, 0.1, horizon=0.1)
    found = system.acted()
    assert found is not None
    assert found.idle == ("control.py returned None at every step, and set none of the 1 actuators" if idle else "")
    assert pendulum().acted() is None


def test_a_model_without_actuators_needs_none_to_be_set(pendulum: Make) -> None:
    motor = '<actuator><motor name="Motor" joint="hinge" ctrlrange="-3 3"/></actuator>'
    model = MODEL.replace(motor, "").replace('<actuatorfrc name="torque" actuator="Motor"/>', "")
    system = pendulum(CONTROLLED, control="def balance(model, data):\n    pass\n", model=model)
    rolled(system, 0.2, 0.1, horizon=0.1)
    assert system.acted() == Acts()


def test_a_package_that_is_not_installed_is_named_with_the_command(
    pendulum: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(DefinitionError, match=r"mujoco is not installed; pip install 'perfbound\[mujoco\]'$"):
        pendulum()

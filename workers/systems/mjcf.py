"""Models for MuJoCo as systems under test: positions, velocities and actuators are parameters, sensors are columns.

| symbol | name         | meaning                                                       | shape     | unit    |
|--------|--------------|---------------------------------------------------------------|-----------|---------|
| q      | `qpos`       | positions of the joints                                       | (nq,)     | m, rad  |
| v      | `qvel`       | velocities of the joints                                      | (nv,)     | m/s, rad/s |
| u      | `ctrl`       | values of the actuators, held for one `step`                  | (nu,)     | of each |
| h      | `step`       | time between two samples, a multiple of the model's time step | ()        | s       |
"""

import copy
import inspect
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...schemas.errors import DefinitionError, SimulationError, meant, shortened
from ...schemas.file.config import CampaignConfig
from ...schemas.file.space import SystemChoice
from ...schemas.system import OptionValue, Parameter, SystemSpec, Variant, timed_columns
from ...schemas.system_check import Acts
from ...schemas.trajectory.input_signal import InputSignal
from ...schemas.trajectory.trajectory import Trajectory
from ..faults import missing
from .base import Progress, SystemUnderTest, checked_options
from .declared import DeclaredFiles, WithSpec, declared_files
from .described import (
    DescribedSystem,
    blaming,
    check_file,
    check_horizon,
    fixed_option,
    listed,
    name_of,
    of_campaign,
    own_name,
    placed,
    space_parameters,
    steps_within,
)
from .files import code_beside
from .fingerprint import versions_of
from .mujoco_warnings import WARNINGS, listen
from .policy import Policy, load_policy

MAX_STEPS = 10_000_000
SEED_BITS = 53
KEYFRAME = "keyframe"
FORMS = {
    "FREE": (("m", "m", "m", "", "", "", ""), ("m/s", "m/s", "m/s", "rad/s", "rad/s", "rad/s")),
    "BALL": (("", "", "", ""), ("rad/s", "rad/s", "rad/s")),
    "SLIDE": (("m",), ("m/s",)),
    "HINGE": (("rad",), ("rad/s",)),
}
"""Units of the positions and velocities of a joint, by its type."""
SENSOR_UNITS = {
    "TOUCH": "N",
    "ACCELEROMETER": "m/s2",
    "VELOCIMETER": "m/s",
    "GYRO": "rad/s",
    "FORCE": "N",
    "TORQUE": "N m",
    "RANGEFINDER": "m",
    "TENDONPOS": "m",
    "TENDONVEL": "m/s",
    "BALLANGVEL": "rad/s",
    "FRAMEPOS": "m",
    "FRAMELINVEL": "m/s",
    "FRAMEANGVEL": "rad/s",
    "FRAMELINACC": "m/s2",
    "FRAMEANGACC": "rad/s2",
    "SUBTREECOM": "m",
    "SUBTREELINVEL": "m/s",
    "GEOMDIST": "m",
    "GEOMFROMTO": "m",
    "E_POTENTIAL": "J",
    "E_KINETIC": "J",
    "CLOCK": "s",
}
"""By the type of a sensor; those of `jointpos` and `jointvel` are those of the joint."""


class Place(NamedTuple):
    """A number of a simulation: its place in an array of `MjData`, and its unit."""

    array: str
    offset: int
    unit: str


class Model(NamedTuple):
    """A model that was read, and how it is simulated."""

    mujoco: Any
    model: Any
    places: Mapping[str, Place]
    """All numbers of it that have a name."""
    keyframe: int
    """-1: none."""
    substeps: int
    recorded: Sequence[str]
    policy: Policy | None
    takes_seed: bool


class MjcfSystem(DescribedSystem):
    """A model for MuJoCo, with a controller or without."""

    def __init__(self, spec: SystemSpec, model: Model) -> None:
        super().__init__(spec)
        self._model = model
        self._idle = False

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
    ) -> Trajectory:
        """Simulate the model from `x`.

        Raises:
            SimulationError: an argument is outside the spec, the controller returns no values of the actuators, or
                MuJoCo warns, as of a simulation that is not stable.
            Cancelled: raised by `progress`.

        """
        checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        step = self._model.substeps * self._model.model.opt.timestep
        steps = steps_within(horizon, step, self._spec.name)
        start = dict(zip((each.name for each in self._spec.parameters), x, strict=True))
        WARNINGS.clear()
        rows = np.empty((steps + 1, 1 + len(self._model.recorded)))
        rows[:, 0] = step * np.arange(steps + 1)
        for k, row in enumerate(self._simulated(start, seed, rows[:, 0])):
            rows[k, 1:] = row
            progress(k)
            if WARNINGS:  # it has put the model back to its first state, and would continue from there
                raise SimulationError(
                    f"MuJoCo: {shortened(WARNINGS[0])} (after t = {rows[k, 0]:g} s); give the model a smaller "
                    "timestep, or starts that it can simulate"
                )
        return Trajectory(self._spec.own_columns, rows)

    def _simulated(self, start: Mapping[str, Any], seed: int, times: Any) -> Iterator[list[float]]:
        """Yield the recorded numbers at each of the times."""
        mujoco, policy = self._model.mujoco, self._model.policy
        # A function of the user may change the model, too.
        model = copy.copy(self._model.model) if policy is not None else self._model.model
        data = mujoco.MjData(model)
        signals = self._begun(model, data, start, seed)
        control = None if policy is None else policy.act
        if policy is not None and policy.reset is not None:
            policy.reset()
        in_halves = model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4
        arrays = [(getattr(data, place.array), place.offset) for place in map(self._place, self._model.recorded)]
        last = len(times) - 1
        self._idle, unset = control is not None and bool(model.nu), _set_values(data)
        for k, t in enumerate(times.tolist()):
            for index, signal in signals.items():
                data.ctrl[index] = signal(t)
            if control is not None:
                # It sees positions, velocities and their sensors of this time.
                (mujoco.mj_step1 if in_halves else mujoco.mj_forward)(model, data)
                returned = control(model, data)
                self._idle = self._idle and returned is None and _set_values(data) == unset
                self._apply(returned, data)
            state = [None if array is data.sensordata else array[index] for array, index in arrays]
            if k == last:
                mujoco.mj_forward(model, data)
            elif control is not None and in_halves:
                mujoco.mj_step2(model, data)
            else:
                mujoco.mj_step(model, data)
            # A step calculates the sensors of its beginning.
            found = zip(state, arrays, strict=True)
            yield [array[index] if value is None else value for value, (array, index) in found]
            if k < last and self._model.substeps > 1:
                mujoco.mj_step(model, data, self._model.substeps - 1)

    def acted(self) -> Acts | None:
        """Return whether the controller set anything in the last rollout; None without one."""
        if self._model.policy is None:
            return None
        name, count = self._model.policy.path.name, self._model.model.nu
        idle = f"{name} returned None at every step, and set none of the {count} actuators"
        return Acts(idle=idle if self._idle else "")

    def _place(self, name: str) -> Place:
        return self._model.places[name]

    def _begun(self, model: Any, data: Any, start: Mapping[str, Any], seed: int) -> dict[int, InputSignal]:
        """Set the first state; return the signals of the actuators, by their places."""
        mujoco, policy = self._model.mujoco, self._model.policy
        if self._model.keyframe >= 0:
            mujoco.mj_resetDataKeyframe(model, data, self._model.keyframe)
        if policy is not None and policy.start is not None:
            given = {name: value if isinstance(value, InputSignal) else float(value) for name, value in start.items()}
            policy.start(model, data, **given, **({"seed": seed} if self._model.takes_seed else {}))
            return {}
        signals = {}
        for name, value in start.items():
            place = self._place(name)
            if isinstance(value, InputSignal):
                signals[place.offset] = value
            else:
                getattr(data, place.array)[place.offset] = value
        return signals

    def _apply(self, returned: Any, data: Any) -> None:
        """Set what a controller returned; None says that it has set the values itself."""
        policy = self._model.policy
        assert policy is not None, "of a controller"
        if returned is not None:
            values = np.asarray(returned)
            if values.dtype.kind not in "fiub" or values.size != data.ctrl.size:
                numeric = values.dtype.kind in "fiub"
                given = f"{values.size} numbers" if numeric else shortened(repr(returned))
                raise SimulationError(
                    f"{policy.path.name} returned {given} at t = {data.time:g} s, and not a number for each of the "
                    f"{data.ctrl.size} actuators"
                )
            data.ctrl[:] = values.ravel()
        if not np.isfinite(data.ctrl).all():
            raise SimulationError(
                f"{policy.path.name} gives an actuator {shortened(repr(data.ctrl.tolist()))} at t = {data.time:g} s"
            )


def load_mjcf(file: Path, config: CampaignConfig) -> SystemUnderTest:
    """Return the model for MuJoCo of a campaign, read from `file`.

    Raises:
        DefinitionError: MuJoCo is not installed, it cannot read the model, or a name in the file is not in it.

    """
    choice, folder, where = config.system, file.absolute().parent, str(file)
    assert choice.mjcf is not None, "of a model"
    path = folder / choice.mjcf
    try:
        import mujoco  # noqa: PLC0415  (an extra)
    except ImportError:
        raise DefinitionError(f"{where}: system.mjcf: mujoco is not installed; {missing('mujoco')}") from None
    place = f"{where}: system.mjcf: {choice.mjcf}"
    check_file(path, place)
    listen(mujoco)
    with blaming(place):
        # All that it consists of: included models, meshes, textures.
        used = [Path(each) for each in mujoco.mju_getXMLDependencies(str(path))]
    named = [str(each.relative_to(folder) if each.is_relative_to(folder) else each) for each in used]
    with placed(f"{where}: system"):
        # Before the model is read: a later one would be another system.
        files = DeclaredFiles(declared_files(named, folder) | declared_files(choice.files or (), folder))
    with blaming(place):
        model = mujoco.MjModel.from_xml_path(str(path))
    keyframe = _keyframe(model, choice, where)
    policy = _controller(choice, folder, where)
    places = _places(mujoco, model)
    parameters = tuple(space_parameters(config, where))
    if policy is None or policy.start is None:
        parameters = tuple(_set_by_name(model, each, places, policy, where) for each in parameters)
    names = [each.name for each in parameters]
    takes_seed = policy is not None and policy.start is not None and _check_reset(policy, names, where)
    substeps = _substeps(choice.step, float(model.opt.timestep), where)
    step = substeps * float(model.opt.timestep)
    check_horizon(config.horizon, step, where)
    columns = _columns(places, choice.columns, where)
    with placed(f"{where}: system"):
        spec = SystemSpec(
            name=name_of(choice.mjcf, "model"),
            doc=f"{choice.mjcf} in MuJoCo with a time step of {model.opt.timestep:g} s, recorded every {step:g} s"
            + (f", with {choice.controller}" if choice.controller else ""),
            parameters=parameters,
            columns=timed_columns(columns),
            options=tuple(fixed_option(name, value) for name, value in sorted(choice.options.items())),
            variants=("nominal",),
            noisy=("nominal",) if takes_seed else (),
            timed=True,
            max_horizon=step * MAX_STEPS,
            default_horizon=config.horizon,
            seed_bits=SEED_BITS,
            code=(policy.digests | code_beside(folder) if policy else {}) | files.digests,
            versions=(policy.versions if policy else {}) | versions_of((), {"mujoco"}),
        )
    found = Model(mujoco, model, places, keyframe, substeps, list(columns), policy, takes_seed)
    return WithSpec(MjcfSystem(spec, found), files)


def _set_values(data: Any) -> tuple[bytes, ...]:
    """Return what a controller may set in place of what it returns, bit by bit."""
    return tuple(each.tobytes() for each in (data.ctrl, data.qfrc_applied, data.xfrc_applied, data.mocap_pos))


def _controller(choice: SystemChoice, folder: Path, where: str) -> Policy | None:
    if choice.controller is None:
        return None
    with placed(f"{where}: system.controller"):
        return load_policy(choice.controller, folder, "model, data")


def _places(mujoco: Any, model: Any) -> dict[str, Place]:
    """Return the numbers of a model that are parameters or columns, by their names."""
    places = dict[str, Place]()
    for k in range(model.njnt):
        joint = model.joint(k)
        positions, velocities = FORMS[_kind(mujoco.mjtJoint, model.jnt_type[k])]
        for array, first, units in (
            ("qpos", int(model.jnt_qposadr[k]), positions),
            ("qvel", int(model.jnt_dofadr[k]), velocities),
        ):
            places |= _named(array, joint.name, first, units)
    for k in range(model.nu):
        places |= _named("ctrl", model.actuator(k).name, k, ("",))
    for k in range(model.nsensor):
        units = (_sensor_unit(mujoco, model, k),) * int(model.sensor_dim[k])
        first = int(model.sensor_adr[k])
        name = own_name(model.sensor(k).name) or f"sensor_{k}"
        for i, unit in enumerate(units):
            places[name if len(units) == 1 else f"{name}_{i}"] = Place("sensordata", first + i, unit)
    return places


def _named(array: str, name: str, first: int, units: Sequence[str]) -> Iterator[tuple[str, Place]]:
    """Yield the numbers of a joint or an actuator: by its name if it has one, and by their places in the array."""
    for i, unit in enumerate(units):
        place = Place(array, first + i, unit)
        if own := own_name(name):
            yield f"{array}_{own}" + (f"_{i}" if len(units) > 1 else ""), place
        yield f"{array}_{first + i}", place


def _kind(enumeration: Any, value: int) -> str:
    """Return the name of a type of MuJoCo, as `HINGE` of `mjJNT_HINGE`."""
    return str(enumeration(value).name).partition("_")[2]


def _sensor_unit(mujoco: Any, model: Any, k: int) -> str:
    kind = _kind(mujoco.mjtSensor, model.sensor_type[k])
    if kind in {"JOINTPOS", "JOINTVEL"}:
        return FORMS[_kind(mujoco.mjtJoint, model.jnt_type[model.sensor_objid[k]])][kind == "JOINTVEL"][0]
    return SENSOR_UNITS.get(kind, "")


def _set_by_name(
    model: Any, parameter: Parameter, places: Mapping[str, Place], policy: Policy | None, where: str
) -> Parameter:
    """Return a parameter with the unit of what it sets.

    Raises:
        DefinitionError: it sets nothing, is in another unit or beyond the range of its joint, or is set by the
            controller.

    """
    name, settable = parameter.name, [name for name, place in places.items() if place.array != "sensordata"]
    if name not in settable:
        file = policy.path.name if policy else "the file of a controller"
        raise DefinitionError(
            f"{where}: space: {meant(name, settable)}{name!r} is none of {listed(settable)}; set others by a "
            f"function reset(model, data, *, {name}) in {file}"
        )
    place = places[name]
    if parameter.signal and place.array != "ctrl":
        raise DefinitionError(f"{where}: space: {name} is no actuator, and no input over time")
    if place.array == "ctrl" and policy is not None:
        raise DefinitionError(f"{where}: space: {name} is set by the controller at every step; leave one of both out")
    if parameter.unit and place.unit and parameter.unit != place.unit:
        turned = (parameter.unit, place.unit) == ("deg", "rad")
        ends = [math.radians(each) for each in (parameter.low, parameter.high)]
        remedy = f"; give [{ends[0]:.6g}, {ends[1]:.6g}]" if turned else ""
        raise DefinitionError(f"{where}: space: {name} is in {place.unit}, and not in {parameter.unit}{remedy}")
    for joint in range(model.njnt):
        if place.array == "qpos" and model.jnt_qposadr[joint] == place.offset and model.jnt_limited[joint]:
            low, high = model.jnt_range[joint].tolist()
            if parameter.low < low or parameter.high > high:
                raise DefinitionError(
                    f"{where}: space: {name} = [{parameter.low:g}, {parameter.high:g}] goes beyond [{low:g}, "
                    f"{high:g}], the range of its joint"
                )
    return parameter.model_copy(update={"unit": parameter.unit or place.unit})


def _check_reset(policy: Policy, names: Sequence[str], where: str) -> bool:
    """Refuse parameters that are not those of the function `reset`; return whether it takes a seed."""
    assert policy.start is not None, "of a function"
    taken = inspect.signature(policy.start).parameters
    every = any(each.kind is inspect.Parameter.VAR_KEYWORD for each in taken.values())
    if not every and (missing := next((name for name in names if name not in taken), None)):
        raise DefinitionError(
            f"{where}: space: the function reset in {policy.path.name} sets the first state, and has no argument "
            f"{missing!r}; write def reset(model, data, *, {', '.join(names)}): ..."
        )
    needed = [each for each in list(taken.values())[2:] if each.default is inspect.Parameter.empty]
    for each in needed:
        if each.kind in {each.KEYWORD_ONLY, each.POSITIONAL_OR_KEYWORD} and each.name not in {*names, "seed"}:
            raise DefinitionError(
                f"{where}: space: {each.name} has no range, and the function reset in {policy.path.name} takes it; "
                "give it one, or a default there"
            )
    return "seed" in taken


def _substeps(step: float | None, timestep: float, where: str) -> int:
    if step is None:
        return 1
    substeps = round(step / timestep)
    if not substeps or abs(substeps * timestep - step) > 1e-9 * step:
        raise DefinitionError(
            f"{where}: system.step: {step:g} s is no multiple of the model's time step, {timestep:g} s; give "
            f"{max(substeps, 1) * timestep:g}, or set timestep in the model"
        )
    return substeps


def _columns(places: Mapping[str, Place], chosen: Mapping[str, str] | None, where: str) -> dict[str, str]:
    """Return the own columns and their units."""
    if chosen is None:
        sensors = {name: each.unit for name, each in places.items() if each.array == "sensordata"}
        # Without sensors, each number of a joint once: its first name.
        joints: dict[tuple[str, int], str] = {}
        for name, each in places.items():
            if each.array in {"qpos", "qvel"}:
                joints.setdefault((each.array, each.offset), name)
        return sensors or {name: places[name].unit for name in joints.values()}
    for name, unit in chosen.items():
        if name not in places:
            raise DefinitionError(
                f"{where}: system.columns: {meant(name, places)}{name!r} is none of {listed(list(places))}; add a "
                "sensor to the model for others"
            )
        if unit and places[name].unit and unit != places[name].unit:
            raise DefinitionError(f"{where}: system.columns: {name} is in {places[name].unit}, and not in {unit}")
    return {name: unit or places[name].unit for name, unit in chosen.items()}


def _keyframe(model: Any, choice: SystemChoice, where: str) -> int:
    """Return the place of the keyframe that the campaign file names, or -1."""
    for name in choice.options:
        if name != KEYFRAME:
            hint = meant(name, [*SystemChoice.model_fields, KEYFRAME])
            raise DefinitionError(
                f"{where}: system: {of_campaign(name) or hint}a model for MuJoCo has no option {name!r}, "
                f"only {KEYFRAME}; a value of a function `reset` is a default there"
            )
    if KEYFRAME not in choice.options:
        return -1
    named = choice.options[KEYFRAME]
    known = [model.key(k).name for k in range(model.nkey)]
    if named not in known:
        listed = f"none of {', '.join(known)}" if known else "no keyframe: the model has none"
        raise DefinitionError(f"{where}: system.{KEYFRAME}: {named!r} is {listed}")
    return known.index(named)

"""Functional Mock-up Units (FMI 2 and 3) as systems under test: one communication step is one sample.

Start values are parameters, outputs are columns; both have the units of the model description. Names are those of the
variables in lower case, with `_` for everything else: `tank[1].level` is `tank_1_level`.
"""

import atexit
import math
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...schemas.errors import DefinitionError, SimulationError, meant, shortened
from ...schemas.file.config import CampaignConfig
from ...schemas.file.space import SystemChoice
from ...schemas.system import OptionValue, Parameter, SystemSpec, Variant, timed_columns
from ...schemas.trajectory.input_signal import InputSignal
from ...schemas.trajectory.trajectory import Floats, Trajectory
from ..faults import NOT_OF_SYSTEMS, missing
from .base import Cancelled, Progress, SystemUnderTest, checked_options
from .declared import DeclaredFiles, WithSpec, declared_files
from .described import (
    DescribedSystem,
    blaming,
    check_file,
    check_horizon,
    check_whole,
    fixed_option,
    listed,
    name_of,
    of_campaign,
    own_name,
    own_words,
    placed,
    space_parameters,
    steps_within,
)
from .fingerprint import versions_of

MAX_STEPS = 10_000_000
SEED = "seed"
"""The variable of an FMU that draws numbers."""
SEED_BITS = 31
"""Of a seed, which is an integer of FMI 2."""
FAILED = 2
"""The first status of FMI that is no warning: a step that is discarded."""
INTERFACES = {"co-simulation": "CoSimulation", "model-exchange": "ModelExchange"}


class Variables:
    """The scalar variables of a model description, by the names that they have here."""

    def __init__(self, description: Any, unit: str) -> None:
        self._unit = unit
        """The name of the file."""
        self._named = dict[str, list[Any]]()
        for each in description.modelVariables:
            if not each.dimensions and each.name != "time":
                self._named.setdefault(own_name(each.name), []).append(each)
        self.outputs = [own_name(each.name) for each in description.modelVariables if self._is_output(each)]

    def _is_output(self, variable: Any) -> bool:
        return variable.causality == "output" and not variable.dimensions and variable.type not in {"String", "Binary"}

    def found(self, name: str, place: str, also: Sequence[str] = ()) -> Any:
        """Return the variable of a name.

        Raises:
            DefinitionError: there is none, or there are several; `also` are other words that may be meant.

        """
        found = self._named.get(name, [])
        if len(found) > 1:
            found = [each for each in found if each.name == name] or found
        if len(found) == 1:
            return found[0]
        if found:
            raise DefinitionError(
                f"{place}: {name} may be {' or '.join(each.name for each in found)} of {self._unit}; rename one of "
                "them in the model"
            )
        hint = meant(name, [*self._named, *also])
        raise DefinitionError(f"{place}: {hint}{self._unit} has no variable {name!r}, only {listed(list(self._named))}")

    def settable(self, name: str, place: str, also: Sequence[str] = ()) -> Any:
        """Return the variable of a name whose value is given to a simulation; raises as `found`, and for others."""
        variable = self.found(name, place, also)
        exact = variable.initial == "exact" and variable.variability != "constant"
        if variable.causality == "input" or exact or variable.variability == "tunable":
            return variable
        given = [each.name for each in self.all if each.causality in {"parameter", "input"} or each.initial == "exact"]
        raise DefinitionError(
            f"{place}: {variable.name} is calculated by {self._unit}, and no start value; it takes "
            f"{listed(list(map(own_name, given)))}"
        )

    @property
    def all(self) -> Iterator[Any]:
        """All scalar variables."""
        for each in self._named.values():
            yield from each


class Library:
    """The loaded library of an FMU, which makes an instance for every rollout: a reset one often keeps something."""

    def __init__(self, fmpy: Any, folder: str, description: Any, interface: str) -> None:
        self._said = list[str]()
        """What it says of errors, since its last instance."""
        fmi2 = description.fmiVersion == "2.0"
        logger = _logger(self._said, fmi2=fmi2)
        self._fmu = fmpy.instantiate_fmu(folder, description, INTERFACES[interface], logger=logger)
        self._arguments = {"callbacks": self._fmu.callbacks} if fmi2 else {"logMessage": logger}
        self._free = self._fmu.fmi2FreeInstance if fmi2 else self._fmu.fmi3FreeInstance
        self.free()

    def instance(self) -> Any:
        """Make an instance; there is one at a time.

        Raises:
            SimulationError: the FMU makes none.

        """
        self._said.clear()
        try:
            self._fmu.instantiate(**self._arguments)
        except Exception as error:  # noqa: BLE001  (of the FMU; its own reason is in the log)
            raise SimulationError(self.blamed(error)) from None
        return self._fmu

    def free(self) -> None:
        """Free the instance."""
        self._free(self._fmu.component)

    def blamed(self, error: Exception) -> str:
        """Return an error in words, with the last ones of the FMU."""
        return shortened("; ".join([own_words(error), *self._said[-1:]]))


class Unit(NamedTuple):
    """An FMU that was unpacked, and how it is simulated."""

    folder: str
    library: Library
    description: Any
    interface: str
    """A key of `INTERFACES`."""
    step: float
    parameters: Mapping[str, Any]
    """The variables of the parameters, by their names."""
    inputs: Sequence[Any]
    """All inputs, if one of them is a signal."""
    fixed: Mapping[str, Any]
    """Start values that the campaign file gives, by the names of the variables."""
    recorded: Sequence[Any]
    seeded: str | None
    """The variable that gets the seed."""


class FmuSystem(DescribedSystem):
    """An FMU; every rollout has an instance of its own."""

    def __init__(self, spec: SystemSpec, unit: Unit) -> None:
        super().__init__(spec)
        self._unit = unit

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
        """Simulate the FMU from its start values `x`.

        Raises:
            SimulationError: an argument is outside the spec, or the FMU fails.
            Cancelled: raised by `progress`.

        """
        import fmpy  # noqa: PLC0415  (an extra)

        checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        unit = self._unit
        steps = steps_within(horizon, unit.step, self._spec.name)
        given = dict(zip(unit.parameters, x, strict=True))
        starts = dict(unit.fixed)
        for name, variable in unit.parameters.items():
            value = given[name]
            starts[variable.name] = typed(variable, value(0.0) if isinstance(value, InputSignal) else value)
        if unit.seeded is not None:
            starts[unit.seeded] = seed
        experiment = unit.description.defaultExperiment
        begin = float((experiment and experiment.startTime) or 0.0)
        instance, reached = unit.library.instance(), [begin]
        try:
            found = fmpy.simulate_fmu(
                unit.folder,
                start_time=begin,
                stop_time=begin + steps * unit.step,
                output_interval=unit.step,
                record_events=False,
                fmi_type=INTERFACES[unit.interface],
                start_values=starts,
                input=self._inputs(given, starts, begin, steps, horizon),
                output=[each.name for each in unit.recorded],
                step_finished=_stepped(reached, progress),
                model_description=unit.description,
                fmu_instance=instance,
            )
        except (SimulationError, Cancelled, *NOT_OF_SYSTEMS):
            raise
        except Exception as error:  # noqa: BLE001  (of fmpy and of the FMU)
            raise SimulationError(f"after t = {reached[-1] - begin:g} s: {unit.library.blamed(error)}") from None
        finally:
            unit.library.free()
        rows = _on_steps(found["time"], begin, unit.step)
        samples = np.empty((len(rows), 1 + len(unit.recorded)))
        samples[:, 0] = unit.step * np.arange(len(rows))
        for k, variable in enumerate(unit.recorded, start=1):
            samples[:, k] = found[variable.name][rows]
        return Trajectory(self._spec.own_columns, samples)

    def _inputs(
        self, given: Mapping[str, Any], starts: Mapping[str, Any], begin: float, steps: int, horizon: float
    ) -> Any:
        """Return all inputs over time, as fmpy takes them; None without a signal.

        Where a signal jumps, its time stands twice: the value before it, and the one behind it.
        """
        unit = self._unit
        if not unit.inputs:
            return None
        signals = {unit.parameters[name].name: each for name, each in given.items() if isinstance(each, InputSignal)}
        grid = unit.step * np.arange(steps + 1)
        jumps = {t for each in signals.values() if each.kind == "constant" for t in each.times[1:] if t < horizon}
        times = np.sort(np.concatenate([grid, *([t, t] for t in jumps)])) if jumps else grid
        before = np.concatenate([times[:-1] == times[1:], [False]])
        table = np.zeros(len(times), dtype=[("time", float), *((each.name, float) for each in unit.inputs)])
        table["time"] = begin + times
        for variable in unit.inputs:
            if (signal := signals.get(variable.name)) is None:
                table[variable.name] = float(starts.get(variable.name, variable.start or 0.0))
            else:
                table[variable.name] = signal(np.where(before, times - 1e-6 * unit.step, times))
        return table


def load_fmu(file: Path, config: CampaignConfig) -> SystemUnderTest:
    """Return the FMU of a campaign, read from `file`.

    Raises:
        DefinitionError: fmpy is not installed, there is no such FMU, it is none or not for this platform, or a name in
            the file is not in its model description.

    """
    choice, folder, where = config.system, file.absolute().parent, str(file)
    assert choice.fmu is not None, "of an FMU"
    path = folder / choice.fmu
    try:
        import fmpy  # noqa: PLC0415  (an extra)
    except ImportError:
        raise DefinitionError(f"{where}: system.fmu: fmpy is not installed; {missing('fmpy')}") from None
    place = f"{where}: system.fmu: {choice.fmu}"
    check_file(path, place)
    if not zipfile.is_zipfile(path):
        raise DefinitionError(f"{place}: this file is no FMU, which is a zip archive")
    with placed(f"{where}: system"):
        # Before it is read: a later one would be another system.
        files = DeclaredFiles(declared_files((choice.fmu, *(choice.files or ())), folder))
    with blaming(place):
        # Tools differ in what they write besides; what a simulation needs is checked when it begins.
        description = fmpy.read_model_description(str(path), validate=False)
    interface = _interface(description, choice, where)
    _check_platform(fmpy, path, place)
    variables = Variables(description, path.name)
    step = choice.step or _step_of(description)
    if step is None:
        raise DefinitionError(f"{where}: system.step: {path.name} does not say how often to record it; give its s")
    check_horizon(config.horizon, step, where)
    parameters = tuple(_parameters(variables, config, where))
    names = {each.name: variables.settable(each.name, f"{where}: space") for each in parameters}
    for each in parameters:
        if each.signal and not (names[each.name].causality == "input" and _is_real(names[each.name])):
            raise DefinitionError(f"{where}: space: {each.name} is no input of numbers over time of {path.name}")
    check_whole((name for name, each in names.items() if not _is_real(each)), config, where, "FMU")
    columns = _columns(variables, choice.columns, where, path.name)
    signalled = any(each.signal for each in parameters)
    fixed = _fixed(variables, choice, names, where)
    with blaming(place):
        unpacked = fmpy.extract(str(path))
        atexit.register(shutil.rmtree, unpacked, ignore_errors=True)
        library = Library(fmpy, unpacked, description, interface)
    unit = Unit(
        folder=unpacked,
        library=library,
        description=description,
        interface=interface,
        step=step,
        parameters=names,
        inputs=[each for each in variables.all if each.causality == "input" and _is_real(each)] if signalled else (),
        fixed=fixed,
        recorded=[each for each, _ in columns.values()],
        seeded=variables.settable(SEED, f"{where}: system.noisy").name if choice.noisy else None,
    )
    with placed(f"{where}: system"):
        spec = SystemSpec(
            name=name_of(choice.fmu, "fmu"),
            doc=f"{path.name}, {interface} of FMI {description.fmiVersion} with a step of {step:g} s",
            parameters=parameters,
            columns=timed_columns({name: each for name, (_, each) in columns.items()}, choice.after_end),
            options=tuple(fixed_option(name, value) for name, value in sorted(choice.options.items())),
            variants=("nominal",),
            noisy=("nominal",) if choice.noisy else (),
            timed=True,
            max_horizon=step * MAX_STEPS,
            default_horizon=config.horizon,
            seed_bits=SEED_BITS,
            code=files.digests,
            # An FMU of Python consists of what its sources import as well.
            versions=versions_of(Path(unpacked, "resources").rglob("*.py"), {"fmpy"}),
            after_end=choice.after_end,
        )
    return WithSpec(FmuSystem(spec, unit), files)


def typed(variable: Any, value: OptionValue) -> Any:
    """Return a number as the type of a variable."""
    if variable.type == "String" or _is_real(variable):
        return value
    return bool(value) if variable.type == "Boolean" else round(float(value))


def _is_real(variable: Any) -> bool:
    return variable.type in {"Real", "Float32", "Float64"}


def _interface(description: Any, choice: SystemChoice, where: str) -> str:
    if not description.fmiVersion.startswith(("2.", "3.")):
        raise DefinitionError(
            f"{where}: system.fmu: {choice.fmu} is of FMI {description.fmiVersion}; export it as FMI 2.0 or 3.0"
        )
    has = {"co-simulation": description.coSimulation, "model-exchange": description.modelExchange}
    known = [name for name, found in has.items() if found is not None]
    if not known:
        raise DefinitionError(f"{where}: system.fmu: {choice.fmu} has neither {' nor '.join(has)}")
    if choice.interface is not None and choice.interface not in known:
        raise DefinitionError(f"{where}: system.interface: {choice.fmu} has {known[0]} alone; leave this key out")
    return choice.interface or known[0]


def _check_platform(fmpy: Any, path: Path, place: str) -> None:
    """Refuse an FMU without a library for this platform."""
    with blaming(place), zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    built = sorted({name.split("/")[1] for name in names if re.match("binaries/[^/]+/.", name)})
    if not {fmpy.platform, fmpy.platform_tuple} & set(built):
        raise DefinitionError(
            f"{place}: it is built for {', '.join(built) or 'no platform'}, and this is {fmpy.platform_tuple}; export "
            "it for this one"
        )


def _step_of(description: Any) -> float | None:
    """Return the seconds between two samples that an FMU says."""
    fixed = description.coSimulation and description.coSimulation.fixedInternalStepSize
    found = fixed or (description.defaultExperiment and description.defaultExperiment.stepSize)
    return float(found) if found and float(found) > 0.0 else None


def _unit_of(variable: Any) -> str:
    """Return the unit of a variable; that of a number is none."""
    found = variable.unit or (variable.declaredType.unit if variable.declaredType is not None else None) or ""
    return "" if found == "1" else str(found)


def _range(variable: Any) -> tuple[float, float]:
    """Return the range of a variable, or that of its type."""
    ends = list[float]()
    for end, without in (("min", -math.inf), ("max", math.inf)):
        found = getattr(variable, end)
        if found is None and variable.declaredType is not None:
            found = getattr(variable.declaredType, end)
        ends.append(without if found is None else float(found))
    return ends[0], ends[1]


def _parameters(variables: Variables, config: CampaignConfig, where: str) -> Iterator[Parameter]:
    """Yield the parameters of `[space]` with the units of the FMU; refuse other units, and values outside its range."""
    for each in space_parameters(config, where):
        variable = variables.settable(each.name, f"{where}: space")
        unit = _unit_of(variable)
        if each.unit and unit and each.unit != unit:
            raise DefinitionError(
                f"{where}: space: {each.name} is in {unit}, says the FMU, and not in {each.unit}; give its range in it"
            )
        low, high = _range(variable)
        if each.low < low or each.high > high:
            raise DefinitionError(
                f"{where}: space: {each.name} = [{each.low:g}, {each.high:g}] goes beyond [{low:g}, {high:g}], its "
                "range in the FMU"
            )
        yield each.model_copy(update={"unit": each.unit or unit})


def _columns(
    variables: Variables, chosen: Mapping[str, str] | None, where: str, unit: str
) -> dict[str, tuple[Any, str]]:
    """Return the own columns by their names: the variable of each, and its unit."""
    place = f"{where}: system.columns"
    if chosen is None:
        if not variables.outputs:
            raise DefinitionError(f'{place}: {unit} has no output; name its variables, columns = {{ level = "m" }}')
        found = {name: variables.found(name, place) for name in variables.outputs}
        return {name: (each, _unit_of(each)) for name, each in found.items()}
    columns = dict[str, tuple[Any, str]]()
    for name, given in chosen.items():
        variable = variables.found(name, place)
        if variable.type in {"String", "Binary"}:
            raise DefinitionError(f"{place}: {variable.name} is a {variable.type}, and no number")
        if (own := _unit_of(variable)) and given and own != given:
            raise DefinitionError(f"{place}: {name} is in {own}, says the FMU, and not in {given}")
        columns[name] = (variable, given or own)
    return columns


def _fixed(variables: Variables, choice: SystemChoice, names: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the start values that the file gives as options, by the names of the variables."""
    found = dict[str, Any]()
    for name, value in choice.options.items():
        place = f"{where}: system"
        if hint := of_campaign(name):
            raise DefinitionError(f"{place}: {hint}{name} is no variable of the FMU")
        variable = variables.settable(name, place, list(SystemChoice.model_fields))
        if name in names:
            raise DefinitionError(f"{place}.{name}: is a parameter of [space], too; leave out one of them")
        if isinstance(value, str) != (variable.type == "String"):
            raise DefinitionError(f"{place}.{name}: {value!r} is no value of a {variable.type}; {_takes(variable)}")
        if not isinstance(value, str) and not _fits(variable, value):
            raise DefinitionError(f"{place}.{name}: {value:g} is not allowed; {_takes(variable)}")
        found[variable.name] = typed(variable, value)
    return found


def _fits(variable: Any, value: float) -> bool:
    """Whether a variable takes a number: by its type and its range."""
    if variable.type == "Boolean":
        return value in {0.0, 1.0}
    low, high = _range(variable)
    return low <= value <= high and (_is_real(variable) or float(value).is_integer())


def _takes(variable: Any) -> str:
    """Return the values of a variable in words."""
    if variable.type == "String":
        return "give text in quotes"
    if variable.type == "Boolean":
        return "give 0 or 1"
    low, high = _range(variable)
    limits = "" if (low, high) == (-math.inf, math.inf) else f" from {low:g} to {high:g}"
    return f"give a {'number' if _is_real(variable) else 'whole number'}{limits}"


def _logger(said: list[str], *, fmi2: bool) -> Callable[..., None]:
    """Return the function to which an FMU says what went wrong; its last words belong to the error."""

    def log(*arguments: Any) -> None:
        status, message = (arguments[2], arguments[4]) if fmi2 else (arguments[1], arguments[3])
        if status >= FAILED and message:
            said.append(message.decode("utf-8", "replace").strip())

    return log


def _stepped(reached: list[float], progress: Progress) -> Callable[[float, Any], bool]:
    """Return the function that is called after every step; the time of the last one is the end of `reached`."""

    def finished(time: float, recorder: Any) -> bool:  # noqa: ARG001  (of fmpy)
        reached.append(time)
        progress(len(reached))
        return True

    return finished


def _on_steps(times: Floats, begin: float, step: float) -> list[int]:
    """Return the rows at 0, step, 2 step, ...; at an event one may stand twice, and the later one counts."""
    of = {round((t - begin) / step): row for row, t in enumerate(times.tolist())}
    return list(of.values())

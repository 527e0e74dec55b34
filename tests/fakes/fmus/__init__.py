"""FMUs for tests, of FMI 2 and 3: the tank of `tank.c`, compiled here."""

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).with_name("tank.c")
COMPILER = shutil.which("cc") or shutil.which("gcc")
NO_COMPILER = "there is no C compiler: apt install gcc"
FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Tank" guid="{{tank}}" numberOfEventIndicators="1">
  {interfaces}
  <UnitDefinitions><Unit name="m"/><Unit name="m3/s"/><Unit name="m/s"/></UnitDefinitions>
  <TypeDefinitions><SimpleType name="Height"><Real unit="m" min="0" max="20"/></SimpleType></TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6"{step}/>
  <ModelVariables>
    <ScalarVariable name="Tank.level0" valueReference="0" causality="parameter" variability="fixed" initial="exact">
      <Real declaredType="Height" start="1"/></ScalarVariable>
    <ScalarVariable name="inflow" valueReference="1" causality="input" variability="continuous">
      <Real unit="m3/s" start="0.1"/></ScalarVariable>
    <ScalarVariable name="leak" valueReference="2" causality="parameter" variability="tunable" initial="exact">
      <Real start="0.2"/></ScalarVariable>
    <ScalarVariable name="limit" valueReference="3" causality="parameter" variability="fixed" initial="exact">
      <Real unit="m" start="99"/></ScalarVariable>
    <ScalarVariable name="Tank.level" valueReference="4" causality="output" variability="continuous"
      initial="calculated"><Real declaredType="Height"/></ScalarVariable>
    <ScalarVariable name="der(level)" valueReference="5" causality="local" variability="continuous"
      initial="calculated"><Real unit="m/s" derivative="5"/></ScalarVariable>
    <ScalarVariable name="stages" valueReference="100" causality="parameter" variability="fixed" initial="exact">
      <Integer start="1"/></ScalarVariable>
    <ScalarVariable name="seed" valueReference="101" causality="parameter" variability="fixed" initial="exact">
      <Integer start="0"/></ScalarVariable>
    <ScalarVariable name="open" valueReference="200" causality="parameter" variability="fixed" initial="exact">
      <Boolean start="true"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="5"/></Outputs>
    <Derivatives><Unknown index="6"/></Derivatives>
  </ModelStructure>
</fmiModelDescription>
"""
FMI3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Tank" instantiationToken="{{tank}}">
  {interfaces}
  <UnitDefinitions><Unit name="m"/><Unit name="m3/s"/><Unit name="m/s"/></UnitDefinitions>
  <TypeDefinitions><Float64Type name="Height" unit="m" min="0" max="20"/></TypeDefinitions>
  <DefaultExperiment startTime="0" stopTime="10" tolerance="1e-6"{step}/>
  <ModelVariables>
    <Float64 name="Tank.level0" valueReference="0" causality="parameter" variability="fixed" initial="exact"
      declaredType="Height" start="1"/>
    <Float64 name="inflow" valueReference="1" causality="input" variability="continuous" unit="m3/s" start="0.1"/>
    <Float64 name="leak" valueReference="2" causality="parameter" variability="tunable" initial="exact" start="0.2"/>
    <Float64 name="limit" valueReference="3" causality="parameter" variability="fixed" initial="exact" unit="m"
      start="99"/>
    <Float64 name="Tank.level" valueReference="4" causality="output" variability="continuous" initial="calculated"
      declaredType="Height"/>
    <Float64 name="der(level)" valueReference="5" causality="local" variability="continuous" initial="calculated"
      unit="m/s" derivative="4"/>
    <Float64 name="room" valueReference="6" causality="local" variability="continuous" initial="calculated" unit="m"/>
    <Int32 name="stages" valueReference="100" causality="parameter" variability="fixed" initial="exact" start="1"/>
    <Int32 name="seed" valueReference="101" causality="parameter" variability="fixed" initial="exact" start="0"/>
    <Boolean name="open" valueReference="200" causality="parameter" variability="fixed" initial="exact" start="true"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="4"/>
    <ContinuousStateDerivative valueReference="5"/>
    <EventIndicator valueReference="6"/>
  </ModelStructure>
</fmiModelDescription>
"""
INTERFACES = {
    "co-simulation": '<CoSimulation modelIdentifier="tank" canHandleVariableCommunicationStepSize="true"/>',
    "model-exchange": '<ModelExchange modelIdentifier="tank"/>',
}


def written(
    path: Path,
    fmi: int,
    *interfaces: str,
    step: float | None = None,
    source: str | None = None,
    platform: tuple[str, str] = ("linux64", "x86_64-linux"),
) -> Path:
    """Write the tank as an FMU; `interfaces` are by default both, in the order of the standard; return its path."""
    names = [each for each in ("model-exchange", "co-simulation") if each in (interfaces or INTERFACES)]
    text = (FMI2 if fmi == 2 else FMI3).format(
        interfaces="\n  ".join(map(INTERFACES.__getitem__, names)),
        step="" if step is None else f' stepSize="{step}"',
    )
    with zipfile.ZipFile(path, "w") as unit:
        unit.writestr("modelDescription.xml", text)
        unit.writestr(f"binaries/{platform[fmi == 3]}/tank.so", library(source or SOURCE.read_text()))
    return path


@cache
def library(source: str) -> bytes:
    """Return the shared library of a source in C."""
    assert COMPILER is not None
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder, "tank.so")
        command = (COMPILER, "-O1", "-w", "-shared", "-fPIC", "-x", "c", "-", "-lm", "-o", built)
        subprocess.run(command, input=source.encode(), check=True)
        return built.read_bytes()

"""The modules that a worker and a bare `import perfbound` load, and the frozen public names."""

import json
import subprocess
import sys

import pytest

import perfbound
import perfbound.systems
from tests.patience import PATIENCE

FORBIDDEN = ("sqlalchemy", "scipy", "sklearn", "perfbound.orchestrator", "perfbound.library")
REPORT = "import atexit, json, sys; atexit.register(lambda: print(json.dumps(sorted(sys.modules)), file=sys.stderr))"
AS_MODULE = "import runpy; runpy.run_module('perfbound.workers', run_name='__main__', alter_sys=True)"


def loaded(*lines: str, arguments: tuple[str, ...] = ()) -> list[str]:
    """Return the modules that a fresh interpreter has loaded at the end of these lines."""
    code = "\n".join((REPORT, *lines))
    command = [sys.executable, "-P", "-c", code, *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    return list(json.loads(ended.stderr.splitlines()[-1]))


def of(modules: list[str], *packages: str) -> list[str]:
    return [name for name in modules if any(name == each or name.startswith(f"{each}.") for each in packages)]


@pytest.mark.integration
@pytest.mark.parametrize(
    ("arguments", "works"),
    [
        (("systems",), "perfbound.workers.systems.segway"),
        (("simulate", "--request", "{}", "--out", "never.mcap"), "perfbound.workers.simulate"),
        (("measure", "--answers", "1", "--begin", "0"), "perfbound.workers.check_system"),
        # The name is refused after everything is imported and before anything is opened.
        (("serve", "--connect", "tcp/127.0.0.1:1", "--name", "no name"), "perfbound.workers.worker"),
    ],
)
def test_a_worker_loads_no_database_no_learning_library_and_no_orchestrator(
    arguments: tuple[str, ...], works: str
) -> None:
    modules = loaded(AS_MODULE, arguments=arguments)
    assert works in modules
    assert of(modules, *FORBIDDEN) == []


@pytest.mark.integration
def test_importing_the_package_loads_no_other_module_of_it() -> None:
    assert of(loaded("import perfbound"), "perfbound") == ["perfbound"]


def test_every_public_name_is_there() -> None:
    assert all(getattr(perfbound, name) is not None for name in perfbound.__all__)
    with pytest.raises(AttributeError, match="no attribute 'orchestra'"):
        _ = perfbound.orchestra


def test_the_public_names_are_frozen() -> None:
    """A name that disappears breaks systems and scripts of users, and a new one is a promise."""
    assert perfbound.__all__ == [
        "Campaign",
        "Cancelled",
        "Choice",
        "Column",
        "Disturbance",
        "InputSignal",
        "Law",
        "LogNormal",
        "Normal",
        "Option",
        "Parameter",
        "PerfboundError",
        "Rig",
        "Scenarios",
        "Search",
        "SimulationError",
        "SystemSpec",
        "SystemUnderTest",
        "Trajectory",
        "Triangular",
        "Uniform",
        "Weibull",
        "Worker",
        "__version__",
        "checked_options",
        "normal",
        "open",
        "read_certificate",
        "read_trajectory",
        "resume",
        "robustness",
        "system",
        "uniform",
    ]
    assert perfbound.systems.__all__ == [
        "Cancelled",
        "Choice",
        "Column",
        "Disturbance",
        "InputSignal",
        "Law",
        "LogNormal",
        "Normal",
        "Option",
        "OptionValue",
        "Parameter",
        "Progress",
        "SimulationError",
        "SystemSpec",
        "SystemUnderTest",
        "Trajectory",
        "Transform",
        "Triangular",
        "Uniform",
        "Variant",
        "Visual",
        "Weibull",
        "Worker",
        "checked_options",
        "normal",
        "system",
        "uniform",
    ]
    assert all(hasattr(perfbound.systems, name) for name in perfbound.systems.__all__)

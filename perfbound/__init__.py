"""perfbound: test campaigns for safety-critical systems that end with a certificate.

Importing the package loads nothing: every worker runs this module. The public names load at their first use.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .library.campaign import Campaign
    from .library.rig import Rig
    from .library.run import open_run as open  # noqa: A004  (as os.open: read with its package)
    from .library.run import resume_run as resume
    from .library.run import robustness
    from .library.search import Search
    from .orchestrator.release.regression.replay import Scenarios
    from .results import read_certificate, read_trajectory
    from .schemas import __version__
    from .schemas.errors import PerfboundError
    from .systems import (
        Cancelled,
        Choice,
        Column,
        Disturbance,
        InputSignal,
        Law,
        LogNormal,
        Normal,
        Option,
        Parameter,
        SimulationError,
        SystemSpec,
        SystemUnderTest,
        Trajectory,
        Triangular,
        Uniform,
        Weibull,
        Worker,
        checked_options,
        normal,
        system,
        uniform,
    )

__all__ = [
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
_HOMES = {
    "Campaign": ".library.campaign",
    "PerfboundError": ".schemas.errors",
    "Rig": ".library.rig",
    "Scenarios": ".orchestrator.release.regression.replay",
    "Search": ".library.search",
    "__version__": ".schemas",
    "open": ".library.run:open_run",
    "read_certificate": ".results",
    "read_trajectory": ".results",
    "resume": ".library.run:resume_run",
    "robustness": ".library.run",
}
"""Module of each name, and its name there if it is another one; every other name is in `systems`."""


def __getattr__(name: str) -> Any:
    from importlib import import_module  # noqa: PLC0415

    if name not in __all__:
        raise AttributeError(f"module 'perfbound' has no attribute {name!r}")
    home, _, renamed = _HOMES.get(name, ".systems").partition(":")
    return getattr(import_module(home, __name__), renamed or name)

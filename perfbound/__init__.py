"""perfbound: test campaigns for safety-critical systems that end with a certificate.

Importing the package loads nothing: every worker runs this module. The public names load at their first use.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .results import read_certificate, read_trajectory
    from .schemas import __version__
    from .systems import (
        Cancelled,
        Column,
        Option,
        Parameter,
        SimulationError,
        SystemSpec,
        SystemUnderTest,
        Trajectory,
        checked_options,
        system,
    )

__all__ = [
    "Cancelled",
    "Column",
    "Option",
    "Parameter",
    "SimulationError",
    "SystemSpec",
    "SystemUnderTest",
    "Trajectory",
    "__version__",
    "checked_options",
    "read_certificate",
    "read_trajectory",
    "system",
]


def __getattr__(name: str) -> Any:
    from importlib import import_module  # noqa: PLC0415

    if name not in __all__:
        raise AttributeError(f"module 'perfbound' has no attribute {name!r}")
    home = {"__version__": ".schemas", "read_certificate": ".results", "read_trajectory": ".results"}
    return getattr(import_module(home.get(name, ".systems"), __name__), name)

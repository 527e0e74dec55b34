"""The software that decides a campaign's numbers; it stands in the certificate."""

import platform
from importlib.metadata import PackageNotFoundError, version

from ...schemas import __version__
from ...schemas.system import SystemSpec

DECIDING = ("numpy", "scipy", "scikit-learn")


def software(spec: SystemSpec) -> dict[str, str]:
    """Return name and version of what computes trajectories and bounds."""
    ours = {"perfbound": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in DECIDING} | spec.versions


def here(spec: SystemSpec) -> dict[str, str | None]:
    """Return the versions of the same software on this machine; None where there is none."""
    found: dict[str, str | None] = {**software(spec)}
    return found | {name: _installed(name) for name in spec.versions}


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

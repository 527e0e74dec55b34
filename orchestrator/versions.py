"""The software that decides a campaign's numbers; it stands in the certificate."""

import platform
from importlib.metadata import version

from schemas import __version__
from schemas.system import SystemSpec

DECIDING = ("numpy", "scipy", "scikit-learn")


def software(spec: SystemSpec) -> dict[str, str]:
    """Return name and version of what computes trajectories and bounds."""
    ours = {"perfbound": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in DECIDING} | spec.versions

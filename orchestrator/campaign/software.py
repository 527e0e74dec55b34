"""The software of a campaign: its recorded versions, and the packages that may compute other numbers here."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

from ...schemas import __version__
from ...schemas.system import SystemSpec

NUMERICS = ("numpy", "scipy", "scikit-learn")


class Version(NamedTuple):
    """One package whose installed version is not that of the campaign; None where it is not installed."""

    name: str
    recorded: str
    installed: str | None


def software(spec: SystemSpec) -> dict[str, str]:
    """Return name and version of everything that computes trajectories and bounds."""
    own = {"perfbound": __version__, "python": platform.python_version()}
    code = {name: f"sha256 {digest}" for name, digest in spec.code.items()}
    # To repeat one of its rollouts is to repeat the whole batch.
    unit = {"batch_is_the_unit": "yes"} if spec.batch_is_the_unit else {}
    return own | {name: version(name) for name in NUMERICS} | spec.versions | code | unit


def other_numerics(recorded: Mapping[str, str], spec: SystemSpec) -> list[Version]:
    """Return the packages whose installed versions may compute other numbers than the recorded ones."""
    here: dict[str, str | None] = {**software(spec)}
    # The code of a system in a file is compared where the file is: by the worker.
    here |= {name: _installed(name) for name in spec.versions}
    # Without perfbound: the rules in the header decide what it computes, not its version.
    found = (Version(name, number, here.get(name)) for name, number in recorded.items() if name != "perfbound")
    return [each for each in found if _deciding(each.name, each.recorded) != _deciding(each.name, each.installed)]


def _deciding(name: str, number: str | None) -> str | None:
    # A patch release of Python computes the same floating-point results.
    return number if name != "python" or number is None else ".".join(number.split(".")[:2])


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

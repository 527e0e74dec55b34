"""The software of a campaign: versions in the certificate, and the part of them that decides its numbers."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

from ...schemas import __version__
from ...schemas.system import SystemSpec

NUMERICS = ("numpy", "scipy", "scikit-learn")


class Version(NamedTuple):
    """One package whose version here is not that of the campaign; None where it is not installed."""

    name: str
    then: str
    now: str | None


def software(spec: SystemSpec) -> dict[str, str]:
    """Return name and version of everything that computes trajectories and bounds."""
    ours = {"perfbound": __version__, "python": platform.python_version()}
    return ours | {name: version(name) for name in NUMERICS} | spec.versions


def other_numerics(recorded: Mapping[str, str], spec: SystemSpec) -> list[Version]:
    """Return the packages that may compute other numbers here than those that were recorded.

    The version of perfbound is none of them: the rules of the campaign decide what it computes. Of Python's version
    the first two parts count.
    """
    here: dict[str, str | None] = {**software(spec)}
    here |= {name: _installed(name) for name in spec.versions}
    found = (Version(name, then, here.get(name)) for name, then in recorded.items() if name != "perfbound")
    return [each for each in found if _deciding(each.name, each.then) != _deciding(each.name, each.now)]


def _deciding(name: str, number: str | None) -> str | None:
    return number if name != "python" or number is None else ".".join(number.split(".")[:2])


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

"""The software that decides a campaign's numbers, and the software that does not."""

import platform

import pytest

from perfbound.orchestrator.campaign.software import other_numerics, software
from perfbound.workers.systems import load_system

SPEC = load_system("test-function").spec
NOW = software(SPEC)


def test_the_same_software_has_no_difference() -> None:
    assert other_numerics(NOW, SPEC) == []


def test_another_perfbound_or_patch_of_python_computes_the_same() -> None:
    minor = ".".join(platform.python_version_tuple()[:2])
    assert other_numerics(NOW | {"perfbound": "0.0.1", "python": f"{minor}.999"}, SPEC) == []


@pytest.mark.parametrize("name", ["numpy", "scipy", "scikit-learn", "python"])
def test_other_numerics_are_named(name: str) -> None:
    (found,) = other_numerics(NOW | {name: "3.9.1"}, SPEC)
    assert found == (name, "3.9.1", NOW[name])


def test_software_that_is_not_here_has_no_version() -> None:
    assert other_numerics(NOW | {"a-simulator": "1.0"}, SPEC) == [("a-simulator", "1.0", None)]

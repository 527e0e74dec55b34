"""Systems that are installed and cannot be used here: they hide no other, and the reason says what to do."""

import json
from dataclasses import dataclass
from importlib.metadata import version
from types import SimpleNamespace
from typing import Any

import pytest

from perfbound.orchestrator.fleet.children import child, simulate
from perfbound.schemas.errors import CampaignError, UnknownSystemError
from perfbound.schemas.system import SystemSpec
from perfbound.workers import systems, worker
from perfbound.workers.systems.segway import SegwaySystem, bullet
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests.facts import facts

CALLED = "pybullet.cpython-311-x86_64-linux-gnu.so,sha256=0,1\n"


@dataclass
class Package:
    """An installed package, as `importlib.metadata` has it."""

    name: str
    version: str
    record: str | None

    def read_text(self, name: str) -> str | None:
        return {"RECORD": self.record}[name]


OTHERS = (Package("my-pybullet", "1", "my_pybullet.py,,\npybullet_data/x.obj,,\n"), Package("no-record", "1", None))


def install(monkeypatch: pytest.MonkeyPatch, *packages: Package) -> None:
    monkeypatch.setattr(bullet, "distributions", lambda: [*OTHERS, *packages])


@pytest.mark.parametrize(
    "found",
    [{"pybullet": "3.2.7"}, {"pybullet-arm64": "3.2.8"}, {"pybullet": "3.2.7", "pybullet-arm64": "3.2.8"}],
    ids=" and ".join,
)
def test_the_segway_names_every_package_that_provides_its_simulator(
    monkeypatch: pytest.MonkeyPatch, found: dict[str, str]
) -> None:
    """Of two packages with the same files, nothing shows whose are there."""
    install(monkeypatch, *(Package(name, number, f"pybullet_data/a.obj,,\n{CALLED}") for name, number in found.items()))
    assert SegwaySystem().spec.versions == {"numpy": version("numpy"), **found}


def test_without_a_simulator_the_segway_says_how_to_get_it_and_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    with pytest.raises(UnknownSystemError, match=facts("Python 3.11 pip install pybullet-arm64")):
        _ = SegwaySystem().spec
    monkeypatch.setattr(systems, "load_system", {"segway": SegwaySystem(), "test-function": TestFunctionSystem()}.get)
    found = systems.usable()
    assert found["segway"] == bullet.NEEDS
    assert found["test-function"] == TestFunctionSystem().spec


@pytest.mark.parametrize("fault", [ImportError("no module 'jax'"), SystemExit(3), ZeroDivisionError(), BaseException()])
def test_a_broken_plug_in_hides_no_other(monkeypatch: pytest.MonkeyPatch, fault: BaseException) -> None:
    def load(name: str) -> Any:
        if name == "segway":
            raise fault
        return TestFunctionSystem()

    monkeypatch.setattr(systems, "load_system", load)
    found = systems.usable()
    assert str(found["segway"]).startswith(f"segway: it cannot be loaded: {type(fault).__name__}")
    assert isinstance(found["test-function"], SystemSpec)


def test_a_worker_serves_what_it_can_use(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = TestFunctionSystem().spec
    monkeypatch.setattr(systems, "usable", lambda: {"segway": bullet.NEEDS, "test-function": spec})
    uplink: Any = SimpleNamespace(orchestrators=list)  # all that it needs before it serves
    assert worker.WorkerProcess("w", uplink)._state(None).systems == {"test-function": spec.digest}


def test_the_orchestrator_gives_the_reason_where_the_system_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = TestFunctionSystem().spec
    answer = json.dumps({"segway": bullet.NEEDS, "test-function": spec.model_dump(mode="json")})
    monkeypatch.setattr(child, "ask", lambda *_: answer)
    assert child.system_specs() == {"test-function": spec}
    with pytest.raises(CampaignError, match=facts("^c.toml: system.name: segway: arm64")):
        child.system_spec("segway", "c.toml: system.name")
    with pytest.raises(CampaignError, match=facts("'unicycle' segway test-function")):
        child.system_spec("unicycle", "c.toml: system.name")
    assert [line for line in simulate.describe() if line.startswith("segway")] == [bullet.NEEDS]

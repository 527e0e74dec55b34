"""A campaign of method `kriging` at other starts than planned, with every digest and the chain made to fit.

`verify` plans the starts itself, so that it needs no digest to see it.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.verify.checks import Checks
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.fleet.children import simulate as simulation
from perfbound.orchestrator.mathematics.bounds.kriging import method
from perfbound.orchestrator.mathematics.bounds.kriging.design import Design, plan_design
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.files import relative_path
from perfbound.schemas.ids import FileId, RolloutId
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import read_mcap
from tests.fakes.simulators import noise, robustness, simulate

TESTS, REPLICATES, RESOLUTION = 18, 4, 9
CONFIG = robustness(
    {"method": "kriging", "rkhs_norm": 0.3, "prior_mean": -0.5, "kernel": {"nu": 2.5, "length_scale": 0.8}},
    clip=[-0.1, 1.0],
    max_tests=TESTS,
    replicates=REPLICATES,
    resolution=RESOLUTION,
    recheck=0,
    spot_check=0,
)
LOW, HIGH = 0, 3
"""Tests at two corners: values are low at the first one and high at the other one."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def rising(request: RolloutRequest) -> float:
    return 0.3 + 0.3 * request.x[0] + 0.02 * min(max(noise(request.seed), -3.0), 3.0)


def check(directory: Path, *, again: int = 0) -> Checks:
    return verify_certificate(directory, key=None, again=again, report=lambda *_: None).checks


def exchanged(design: Design) -> Design:
    """Return the design with the starts of two tests exchanged: every start is as often tested as planned."""
    order = list(design.order)
    other = next(test for test in range(TESTS) if order[test] != order[LOW])
    order[LOW], order[other] = order[other], order[LOW]
    return replace(design, order=tuple(order))


def elsewhere(design: Design) -> Design:
    """Return the design with a node inside in place of the first corner: what is low is never seen."""
    inside = RESOLUTION + 1
    assert inside not in design.nodes
    return replace(design, nodes=(inside, *design.nodes[1:]))


def another_share(design: Design) -> Design:
    """Return the design without later tests of the first corner: they are in the middle instead."""
    middle = design.size // 2
    order = [middle if point == 0 and test > 0 else point for test, point in enumerate(design.order)]
    return replace(design, order=tuple(order))


@pytest.mark.parametrize("change", [exchanged, elsewhere, another_share])
def test_other_starts_than_planned_are_found_without_any_digest(
    tmp_path: Path, change: Callable[[Design], Design], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole campaign is run by an altered perfbound: files, database, chain and certificate fit each other."""
    with monkeypatch.context() as altered:
        altered.setattr(method, "plan_design", lambda *arguments: change(plan_design(*arguments)))
        simulate(tmp_path, CONFIG, rising, noisy=True)
        assert check(tmp_path).good, "the forgery is complete: an altered perfbound verifies it"
    checks = check(tmp_path)
    assert [line.name for line in checks.lines() if line.status == "failed"] == ["proposals"]
    assert {name: checks.found[name].status for name in ("header", "manifest", "files")} == dict.fromkeys(
        ("header", "manifest", "files"), "passed"
    )
    assert "was tested, the maximiser is" in checks.found["proposals"].detail


def test_the_planned_starts_pass(tmp_path: Path) -> None:
    simulate(tmp_path, CONFIG, rising, noisy=True)
    assert check(tmp_path).good


def test_exchanged_outcomes_under_the_planned_starts_are_found_by_simulating_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of two tests has the outcomes of the other one's start: no digest and no plan contradicts."""
    honest, forged = tmp_path / "honest", tmp_path / "forged"
    simulate(honest, CONFIG, rising, noisy=True)
    low, high = (start(honest, test) for test in (LOW, HIGH))
    assert low[0] < high[0], "the values of the two starts differ"
    other = {LOW: high, HIGH: low}

    def exchanging(request: RolloutRequest) -> float:
        return rising(request.model_copy(update={"x": other.get(request.test, request.x)}))

    simulate(forged, CONFIG, exchanging, noisy=True)
    assert check(forged).good, "the forgery is complete"

    def simulated(_command: str, _flag: str, wanted: str, _out: str, out: str, **_: object) -> str:
        found = RolloutRequest.model_validate_json(wanted)
        shutil.copy(honest / place(found.test, found.replicate), out)
        return ""

    monkeypatch.setattr(simulation, "ask", simulated)
    checks = check(forged, again=TESTS * REPLICATES)
    assert [line.name for line in checks.lines() if line.status == "failed"] == ["resimulation"]
    assert check(honest, again=TESTS * REPLICATES).good


def place(test: int, replicate: int) -> str:
    return relative_path(FileId(RolloutId("robustness", test, "nominal", replicate)))


def start(directory: Path, test: int) -> list[float]:
    return list(read_mcap((directory / place(test, 0)).read_bytes()).request["x"])

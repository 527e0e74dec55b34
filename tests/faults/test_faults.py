"""One fixed run of every class of faults, and the time to detection and to the next result."""

import json
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from tests.end_to_end.processes import wait_for
from tests.faults.catalogue import FAULTS, Fault, draw, randomness
from tests.faults.delays import DELAYS
from tests.faults.runs import perform
from tests.faults.scene import Scene
from tests.faults.subjects import Subject, prepare
from tests.faults.systems import a_plan
from tests.faults.table import rows
from tests.faults.verdict import REPRODUCIBLE, without
from tests.sharing import made_once, shared_folder

SEED = 2
LONGEST = (
    "router-away",
    "slow-disk",
    "turning-node",
    "lying-node",
    "cut-cable",
    "cut-and-kill",
    "slow-node",
    "poison",
    "fill-disk",
)
"""Classes that begin first, so that at the end no process of the tests waits for one of them."""
LEAST = {"dead-worker": 2.9, "hung-worker": 1.9}
"""Seconds that the orchestrator waits before it gives an attempt up; `make bench` measures how long it takes."""


@pytest.fixture(scope="session")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Subject]:
    """Return a maker of campaigns with their calm runs, each made once for all processes."""
    base = shared_folder(tmp_path_factory)

    def make(name: str) -> Subject:
        return prepare(name, made_once(base / f"subject-{name}", lambda folder: prepare(name, folder)))

    return make


@pytest.mark.parametrize("name", [*LONGEST, *sorted(FAULTS.keys() - LONGEST)])
def test_one_result_per_rollout_and_the_same_certificate(
    name: str, tmp_path: Path, subject: Callable[[str], Subject]
) -> None:
    fault, chance = FAULTS[name], Random(f"{SEED}/{name}")  # a new class changes no run of the others
    if reason := fault.missing():
        pytest.skip(reason)
    run = perform(fault, chance, {fault.subjects[0]: subject(fault.subjects[0])}, tmp_path / "run")
    assert run.verdict.good, (run.done, run.verdict)
    assert run.injected > 0, run.done


@pytest.mark.parametrize("name", sorted(DELAYS))
def test_it_is_noticed_and_not_too_early(name: str, tmp_path: Path, subject: Callable[[str], Subject]) -> None:
    scene = Scene(subject("function"), tmp_path / "scene", randomness(SEED, 0))
    try:
        seconds = DELAYS[name](scene)
        scene.finish()
    finally:
        left = scene.close()
    assert left == []
    assert seconds >= LEAST.get(name, 0.0)


def test_a_schedule_has_every_class_once_a_lap() -> None:
    size = len(FAULTS)
    for lap in range(3):
        assert sorted(draw(SEED, lap * size + place).name for place in range(size)) == sorted(FAULTS)
    assert [draw(1, k).name for k in range(size)] != [draw(2, k).name for k in range(size)]


def test_a_certificate_is_compared_without_one_assumption() -> None:
    def certificate(bound: float, status: str, *refuted: str) -> bytes:
        assumptions = [{"id": "reproducible_rollouts", "status": status}, {"id": "other", "status": "assumed"}]
        claim = {"bound": bound, "assumptions": ["other", "reproducible_rollouts"], "refuted": list(refuted)}
        return json.dumps({"predicate": {"claims": [claim], "assumptions": assumptions}}).encode()

    calm = without(certificate(0.5, "assumed"), REPRODUCIBLE)
    assert without(certificate(0.5, "refuted", "reproducible_rollouts"), REPRODUCIBLE) == calm
    assert without(certificate(0.6, "refuted", "reproducible_rollouts"), REPRODUCIBLE) != calm
    assert without(certificate(0.5, "refuted", "other"), REPRODUCIBLE) != calm


def test_the_judge_finds_an_irreproducible_rollout(tmp_path: Path, subject: Callable[[str], Subject]) -> None:
    """Where none is expected; and its absence where one is."""
    for number, (act, found) in enumerate(((_raise_once, "1 rollouts"), (_expect_a_failure, "0 rollouts"))):
        folder = tmp_path / str(number)
        run = perform(Fault(act), randomness(SEED, 0), {"function": subject("function")}, folder)
        assert run.verdict.different[-1:] == [f"{found} are irreproducible"], run.verdict


def _raise_once(scene: Scene) -> None:
    (a_plan(scene) / f"{scene.subject.seeds[3]}-0-raise").touch()
    scene.start()
    scene.finish()


def _expect_a_failure(scene: Scene) -> None:
    scene.irreproducible = True
    scene.start()
    scene.finish()


def test_the_judge_sees_what_is_wrong(tmp_path: Path, subject: Callable[[str], Subject]) -> None:
    run = perform(Fault(_spoil), randomness(SEED, 0), {"function": subject("function")}, tmp_path / "scene")
    verdict = run.verdict
    assert len(verdict.lost) == 1
    assert verdict.different == ["certificate.json differs from the calm one"]
    assert {Path(each).name for each in verdict.leftovers[:2]} == {"orphan.mcap", "x.partial"}
    assert len(verdict.leftovers) == 3
    assert "signal.pause" in verdict.leftovers[2]
    assert verdict.failures == []
    assert rows([run])[-1] == {
        "fault": "all",
        "runs": 1,
        "injected": 1,
        "twice": 0,
        "lost": 1,
        "different": 1,
        "leftovers": 3,
        "early": 0,
        "failures": 0,
    }


def _spoil(scene: Scene) -> None:
    """Finish, then damage everything that is judged."""
    scene.start()
    scene.finish()
    first, second, *_ = sorted((scene.directory / "trajectories").rglob("*.mcap"))
    first.write_bytes(b"")
    (second.parent / "orphan.mcap").touch()
    (scene.directory / "x.partial").touch()
    (scene.directory / "certificate.json").write_text("{}")
    stubborn = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); signal.pause()"
    process = scene.processes.start("python", "-c", stubborn, **scene.environment)
    wait_for((process.folder / "out").read_text)
    wait_for(lambda: list(scene.alive()) == [process.pid])
    scene.patience = 0.0
    scene.did("spoiled")

"""What a system consists of may not change within a campaign: files, weights, tables and packages, by their names."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, processes, recorded, wait_for

TANK = """
import importlib
import time
from pathlib import Path

import numpy as np
import perfbound as pb
import planty

INNER = importlib.import_module("dynamic" + "_planty")
HERE = Path(__file__).parent


@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""}, files=["Tank.fmu", "policy.pt", "tables"])
def tank(x, *, seed):
    time.sleep(0.05)
    return x + len((HERE / "Tank.fmu").read_bytes()) + 0.01 * np.random.default_rng(seed).normal()
"""
KEYS = """
specification = "y >= 0"
alpha = 0.01
noise_scale = 0.1
rkhs_norm = 10
prior_mean = -3
clip = [-5, 5]
max_tests = 20
spot_check = 5
spot_check_followups = 2
recheck = 3
kernel = { length_scale = 0.5 }
[system]
python = "tank.py:tank"
files = ["more/extra.bin"]
[space]
x = [0, 1]
"""
PACKAGES = {"planty": "Requires-Dist: planty_solver\n", "planty_solver": "", "dynamic_planty": ""}


def package(site: Path, name: str, version: str, more: str = "") -> None:
    for old in site.glob(f"{name}-*.dist-info"):
        shutil.rmtree(old)
    (site / f"{name}.py").write_text("")
    (info := site / f"{name}-{version}.dist-info").mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{more}")


def replaced(path: Path) -> None:
    path.with_name("new").write_bytes(b"PK2")
    path.with_name("new").replace(path)


CHANGES: dict[str, Callable[[Path], object]] = {
    "Tank.fmu is another one here": lambda plant: replaced(plant / "Tank.fmu"),
    "policy.pt is another one here": lambda plant: replaced(plant.parent / "weights.bin"),
    "tables/deep/b.csv is another one here": lambda plant: (plant / "tables/deep/b.csv").write_text("9"),
    "tables/c.csv is new here": lambda plant: (plant / "tables/c.csv").write_text("9"),
    "more/extra.bin is another one here": lambda plant: replaced(plant / "more" / "extra.bin"),
    "planty 1.0": lambda plant: package(plant.parent / "site", "planty", "2.0", PACKAGES["planty"]),
    "planty_solver 1.0": lambda plant: package(plant.parent / "site", "planty_solver", "2.0"),
    "dynamic_planty 1.0": lambda plant: package(plant.parent / "site", "dynamic_planty", "2.0"),
}


def filled(folder: Path) -> Path:
    """Write the system and all that it consists of; return its campaign file."""
    plant = folder / "plant"
    for name in ("tables/deep", "more"):
        (plant / name).mkdir(parents=True)
    (folder / "site").mkdir()
    for name, more in PACKAGES.items():
        package(folder / "site", name, "1.0", more)
    (folder / "weights.bin").write_bytes(b"PK1")
    (plant / "policy.pt").symlink_to(folder / "weights.bin")
    for name in ("Tank.fmu", "tables/a.csv", "tables/deep/b.csv", "more/extra.bin"):
        (plant / name).write_bytes(b"PK1")
    (plant / "tank.py").write_text(TANK)
    (plant / "tank.toml").write_text(KEYS)
    return plant / "tank.toml"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a stopped run and a finished one."""
    folder = tmp_path_factory.mktemp("runs")
    file = filled(folder)
    with processes(folder / "logs") as started, pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder / "site"))
        first = started.start("perfbound", "run", file, "--out", folder / "stopped", "--workers", "1")
        wait_for(lambda: recorded(folder / "stopped") >= 3)
        first.popen.kill()
        first.wait()
        shutil.copytree(folder / "stopped", folder / "finished")
        ended = started.run("perfbound", "resume", folder / "finished")
        assert ended.code == 0, ended.err
    return folder


@pytest.mark.parametrize("words", CHANGES)
def test_another_plant_is_refused_by_its_name(
    started: Processes, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    """At resume, and where rollouts are simulated again."""
    file = filled(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    CHANGES[words](file.parent)
    shutil.copytree(runs / "stopped", tmp_path / "stopped")
    resumed = started.run("perfbound", "resume", tmp_path / "stopped", "--system", file)
    assert resumed.code == 1
    assert words in resumed.last_line
    assert words.partition(" ")[0] in resumed.last_line
    assert recorded(tmp_path / "stopped") == recorded(runs / "stopped")
    verified = started.run("perfbound", "verify", runs / "finished", "--resimulate", "2", "--system", file)
    assert verified.code == 1
    assert words in " ".join(verified.out.split())


def test_the_same_plant_elsewhere_is_the_same(
    started: Processes, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = filled(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    verified = started.run("perfbound", "verify", runs / "finished", "--resimulate", "2", "--system", file)
    assert verified.code == 0, verified.out
    shown = (
        started.run("perfbound", "show", runs / "finished", "--json").out
        + (runs / "finished" / "certificate.json").read_text()
    )
    assert all(name in shown for name in ("Tank.fmu", "policy.pt", "more/extra.bin", "planty_solver"))


@pytest.mark.parametrize("words", ["Tank.fmu is", "tables/deep/b.csv is", "planty_solver 1.0"])
def test_a_worker_with_another_plant_is_refused_by_its_name(
    started: Processes, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    (tmp_path / "other").mkdir()
    other = filled(tmp_path / "other")
    change = next(change for name, change in CHANGES.items() if name.startswith(words))
    change(other.parent)
    monkeypatch.setenv("PYTHONPATH", str(runs / "site"))
    shutil.copytree(runs / "stopped", tmp_path / "run")
    server = started.start("perfbound", "resume", tmp_path / "run", "--workers", "0", "--listen", "tcp/127.0.0.1:0")
    wait_for(lambda: "waiting for workers" in server.err)
    endpoint = server.err.split("--connect ")[1].split()[0]
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "other" / "site"))
    refused = started.run("perfbound-worker", "--connect", endpoint, "--system", other)
    assert refused.code == 1
    assert f"another or no {words.removesuffix(' is')} than the campaign's" in refused.err
    wait_for(lambda: words.removesuffix(" is") in server.err)


def test_a_plant_that_is_replaced_in_mid_run_gets_no_certificate(
    started: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = filled(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    run = started.start("perfbound", "run", file, "--out", tmp_path / "run", "--workers", "1")
    wait_for(lambda: recorded(tmp_path / "run") >= 3)
    replaced(file.parent / "Tank.fmu")
    wait_for(lambda: "Tank.fmu" in run.err)
    assert run.wait().code == 1
    assert not (tmp_path / "run" / "certificate.json").exists()
    (file.parent / "Tank.fmu").write_bytes(b"PK1")
    assert started.run("perfbound", "resume", tmp_path / "run").code == 0

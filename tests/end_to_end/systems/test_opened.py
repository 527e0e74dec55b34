"""Files that rollouts read: those that no system declares are named by `check-system`, and written by `init`."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.end_to_end.processes import Processes

HEAD = """
import ctypes, json, mmap, sqlite3, subprocess
from pathlib import Path
import numpy as np
import perfbound as pb
HERE = Path(__file__).parent
{top}
@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"y": ""}}, step=0.1{more})
def plant(x, *, horizon):
    {body}
    return x + np.zeros(round(horizon / 0.1) + 1)
"""
C_OPEN = (
    "libc = ctypes.CDLL(None); libc.fopen.restype = ctypes.c_void_p; libc.fclose.argtypes = [ctypes.c_void_p]; "
    'libc.fclose(libc.fopen(str(HERE / "{name}").encode(), b"rb"))'
)
PLANTED = {
    "text.txt": 'open(HERE / "text.txt").read()',
    "weights/w.npy": 'np.load(HERE / "weights/w.npy")',
    "conf.json": 'json.loads((HERE / "conf.json").read_text())',
    "by_c.bin": C_OPEN.format(name="by_c.bin"),
    "link.bin": C_OPEN.format(name="link.bin"),
    "table.db": 'sqlite3.connect(HERE / "table.db").execute("select * from a").fetchall()',
    "mapped.bin": 'mmap.mmap((f := open(HERE / "mapped.bin", "r+b")).fileno(), 0).close()',
    "by_cat.txt": 'subprocess.run(["cat", str(HERE / "by_cat.txt")], capture_output=True)',
    "../shared/outside.txt": '(HERE / "../shared/outside.txt").read_bytes()',
    "by_name.py": 'exec((HERE / "by_name.py").read_text())',
}
"""What is read in a rollout, and how."""
AT_LOAD = "at_load.csv"


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    """Return a folder with everything that is read, and more."""
    folder = tmp_path / "plant"
    (folder / "weights").mkdir(parents=True)
    (tmp_path / "shared").mkdir()
    for name in (*PLANTED, AT_LOAD, "unread.txt"):
        (folder / name).write_text("1" if not name.endswith(".json") else "{}")
    np.save(folder / "weights" / "w.npy", np.ones(2))
    (folder / "table.db").unlink()
    with sqlite3.connect(folder / "table.db") as table:
        table.execute("create table a (x)")
    (folder / "link.bin").unlink()
    (folder / "link.bin").symlink_to(tmp_path / "shared" / "target.bin")
    (tmp_path / "shared" / "target.bin").write_text("1")
    return folder


def system(folder: Path, body: str, top: str = "", more: str = "") -> str:
    (folder / "plant.py").write_text(HEAD.format(body=body, top=top, more=more))
    return f"{folder / 'plant.py'}:plant"


def finding(started: Processes, reference: str, *arguments: str) -> Mapping[str, Any]:
    ended = started.run("perfbound", "check-system", reference, "--horizon", "1", "--json", *arguments)
    found: list[Mapping[str, Any]] = json.loads(ended.out)["checks"]
    return next(each for each in found if each["check"] == "files")


def declared(found: Mapping[str, Any]) -> set[str]:
    """Return the files of the line that a finding gives."""
    line = found["remedy"].partition("files = [")[2].partition("]")[0]
    return set(json.loads(f"[{line}]")) if line else set()


def test_every_undeclared_file_is_found_and_none_that_is_not_read(started: Processes, plant: Path) -> None:
    body = "; ".join(PLANTED.values()) + '; (HERE / "scratch").write_text("1"); (HERE / "scratch").read_text()'
    found = finding(started, system(plant, body, top=f'K = (HERE / "{AT_LOAD}").read_text()'))
    assert found["status"] == "warning"
    assert declared(found) == {*PLANTED, AT_LOAD}
    assert all(name in found["detail"] for name in (*PLANTED, AT_LOAD))


def test_what_is_declared_is_not_named(started: Processes, plant: Path) -> None:
    names = [*PLANTED, AT_LOAD]
    reference = system(plant, "; ".join(PLANTED.values()), f'K = (HERE / "{AT_LOAD}").read_text()', f", files={names}")
    found = finding(started, reference)
    assert (found["status"], found["remedy"]) == ("passed", "")


def test_of_many_files_the_folder_is_declared(started: Processes, plant: Path) -> None:
    (plant / "tables").mkdir()
    for number in range(6):
        (plant / "tables" / f"{number}.csv").write_text("1")
    body = '[each.read_text() for each in (HERE / "tables").iterdir()]'
    assert declared(finding(started, system(plant, body))) == {"tables"}
    assert declared(finding(started, system(plant, body, more=', files=["tables"]'))) == set()


@pytest.mark.parametrize("site", ["plant/site", "site"])
def test_a_package_that_only_a_rollout_imports_is_named(
    started: Processes, plant: Path, monkeypatch: pytest.MonkeyPatch, site: str
) -> None:
    """By a computed name: what the file imports is found in its text."""
    folder = plant.parent / site
    (folder / "lazy_planty-1.5.dist-info").mkdir(parents=True)
    text = "Metadata-Version: 2.1\nName: lazy_planty\nVersion: 1.5\n"
    (folder / "lazy_planty-1.5.dist-info" / "METADATA").write_text(text)
    (folder / "lazy_planty.py").write_text("")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    found = finding(started, system(plant, '__import__("lazy" + "_planty")'))
    assert "lazy_planty 1.5" in found["detail"]
    assert finding(started, system(plant, "import lazy_planty"))["status"] == "passed"


SIM = """
import json, sys
request = json.loads(sys.stdin.readline())
K = open("{name}").read()
import helper
with open(request["path"], "w") as file:
    file.write("1\\n" * 11)
print(json.dumps({{"done": True}}))
"""


@pytest.mark.parametrize("name", ["by_cat.txt", "link.bin", "weights/w.txt"])
def test_the_files_that_a_program_reads_are_named(started: Processes, plant: Path, name: str) -> None:
    if name.startswith("weights"):
        (plant / name).write_text("1")
    (plant / "helper.py").write_text("")
    (plant / "sim.py").write_text(SIM.format(name=name))
    text = f'[system]\nprogram = ["{sys.executable}", "-B", "sim.py"]\nstep = 0.1\ncolumns = {{ y = "" }}\n'
    (plant / "p.toml").write_text(text + "[space]\nx = [0, 1]\n")
    assert declared(finding(started, str(plant / "p.toml"))) == {name, "helper.py"}
    out = plant / "sim.toml"
    ended = started.run("perfbound", "init", plant / "p.toml", "--horizon", "1", "--specification", "always (y >= 0)")
    assert ended.code == 0, ended.err
    assert set(tomllib.loads(out.read_text())["system"]["files"]) == {name, "helper.py"}
    assert declared(finding(started, str(out))) == set()


@pytest.mark.parametrize("place", [".", "campaigns"])
def test_init_writes_the_files_into_the_campaign_file(started: Processes, plant: Path, place: str) -> None:
    shutil.rmtree(plant.parent / "shared" / "nothing", ignore_errors=True)
    (plant / "campaigns").mkdir()
    reference, out = system(plant, 'open(HERE / "text.txt").read()'), plant / place / "first.toml"
    formula = ("--specification", "always (y >= -1)")
    ended = started.run("perfbound", "init", reference, "--horizon", "1", *formula, "--out", out)
    assert ended.code == 0, ended.err
    (file,) = tomllib.loads(out.read_text())["system"]["files"]
    assert os.path.samefile(out.parent / file, plant / "text.txt")
    assert declared(finding(started, str(out))) == set()


def test_an_installed_system_names_what_its_package_lacks(started: Processes, tmp_path: Path) -> None:
    """Files of a package above 1 MB are no part of its code."""
    package = tmp_path / "site" / "planty"
    package.mkdir(parents=True)
    (package / "mesh.bin").write_bytes(bytes(2**20 + 1))
    text = HEAD.format(top="", more="", body='open(HERE / "mesh.bin", "rb").read(1)')
    (package / "__init__.py").write_text(text)
    info = tmp_path / "site" / "planty-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: planty\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[perfbound.systems]\nplant = planty:plant\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    command = [str(Path(sys.executable).with_name("perfbound")), "check-system", "plant", "--horizon", "1", "--json"]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    (found,) = [each for each in json.loads(ended.stdout)["checks"] if each["check"] == "files"]
    assert "mesh.bin" in found["detail"], found
    assert declared(found) == {"mesh.bin"}, "relative to the file of the class"

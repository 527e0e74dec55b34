"""The wheel, built from the sdist and installed into an environment of its own: its files, and the main job run there.

The environment cannot import the checkout, and its working folder holds modules with the names of the three folders of
the repository that raise when they are imported. Its dependencies are exactly those of the lock of this Python: links
to what the environment of the tests has of them, or, in the slow test, a fresh installation with checked hashes.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import pytest

from tests.end_to_end.processes import Ended, Processes

ROOT = Path(__file__).parents[3]
LOCK = ROOT / "locks" / "{}.{}.txt".format(*sys.version_info[:2])
BACKEND = ROOT / "build" / "backend"
"""Folder into which `make test` installs the build backend once, so that later runs need no network."""

METADATA = {"PKG-INFO", "README.md", "LICENSE", "pyproject.toml", "setup.cfg", "perfbound.egg-info"}
TRAPS = ("schemas.py", "workers.py", "orchestrator.py")
TRAP = "open({marker!r}, 'a').write(__name__ + '\\n')\nraise ImportError(__name__ + ' of the working folder')\n"
NOT_SOURCES = (".*", "__pycache__", "*.egg-info", "build", "dist", "runs")


def call(line: Sequence[str | Path], folder: Path, **environment: str) -> str:
    """Return the output of a command that must end with 0."""
    ended = subprocess.run(
        line, cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def pip(folder: Path, *arguments: str | Path) -> None:
    call([sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments], folder)


def backend(folder: Path) -> Path:
    """Return the folder of the build backend; without that of `make test` it is downloaded into `folder`."""
    (requirement,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    name, version = requirement.split("==")
    if (BACKEND / f"{name}-{version}.dist-info").exists():
        return BACKEND
    pip(folder, "install", "--target", folder / "backend", requirement)
    return folder / "backend"


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sdist and the wheel that is built from it alone."""
    folder = tmp_path_factory.mktemp("built")
    tools = str(backend(folder))
    # A copy: setuptools leaves build/ and *.egg-info in the folder of the sources, and believes those that it finds.
    sources = Path(shutil.copytree(ROOT, folder / "sources", True, shutil.ignore_patterns(*NOT_SOURCES)))
    code = "import sys; from setuptools import build_meta as b; print(getattr(b, sys.argv[1])(sys.argv[2]))"
    call([sys.executable, "-c", code, "build_sdist", folder], sources, PYTHONPATH=tools)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    call([sys.executable, "-c", code, "build_wheel", folder], unpacked, PYTHONPATH=tools)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel


def locked() -> dict[str, str]:
    """Return name -> version of the lock."""
    return dict(re.findall(r"^([A-Za-z0-9_.-]+)==(\S+)", LOCK.read_text(), re.MULTILINE))


def environment(folder: Path) -> Path:
    """Make an empty environment, and return its Python."""
    call([sys.executable, "-m", "venv", "--without-pip", folder], folder.parent)
    return folder / "bin" / "python"


def link_locked(packages: Path) -> None:
    """Link the locked packages, and no other, into another environment."""
    for name, version in locked().items():
        found = metadata.distribution(name)
        assert found.version == version, name
        home = Path(str(found.locate_file("")))
        for top in {file.parts[0] for file in found.files or ()} - {"..", "__pycache__"}:
            if not (packages / top).exists():
                (packages / top).symlink_to(home / top)


def site_packages(python: Path) -> Path:
    return next((python.parents[1] / "lib").glob("python*/site-packages"))


@pytest.fixture(scope="session")
def linked(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with the wheel and links to the locked packages."""
    folder = tmp_path_factory.mktemp("linked")
    python = environment(folder / "venv")
    link_locked(site_packages(python))
    pip(folder, "--python", python, "install", "--no-deps", "--no-index", built[1])
    return python


def source_files() -> set[str]:
    """Return the files of the package in the checkout, by their names in the wheel."""
    files = set()
    for folder, _, names in os.walk(ROOT / "perfbound", followlinks=True):
        if "__pycache__" not in folder:
            files |= {str(Path(folder, name).relative_to(ROOT)) for name in names}
    return files


def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        links = [each.filename for each in archive.infolist() if (each.external_attr >> 16) & 0o170000 == 0o120000]
    tops = {name.split("/")[0] for name in names}
    (information,) = tops - {"perfbound"}
    assert re.fullmatch(r"perfbound-[\d.]+\.dist-info", information)
    assert {name for name in names if name.startswith("perfbound/")} == source_files()
    assert links == []


def test_the_sdist_holds_the_package_and_its_metadata_alone(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[0]) as archive:
        members = archive.getmembers()
    tops = {each.name.split("/")[1] for each in members if "/" in each.name}
    assert tops == {"perfbound"} | METADATA
    assert [each.name for each in members if each.issym() or each.islnk()] == []


def check(python: Path, started: Processes) -> None:
    """Run the main job with what is installed beside `python`, in a folder of traps."""
    marker = started.folder / "imported"
    for name in TRAPS:
        (started.folder / name).write_text(TRAP.format(marker=str(marker)))

    def run(program: str, *arguments: str | Path) -> Ended:
        ended = started.run(str(python.parent / program), *arguments, PYTHONPATH="")
        assert ended.code == 0, ended.err
        return ended

    code = "import json, sys, perfbound; print(json.dumps([sys.prefix, perfbound.__file__, *sys.path]))"
    prefix, *paths = json.loads(run("python", "-c", code).out)
    assert prefix == str(python.parents[1])
    assert Path(paths[0]).is_relative_to(prefix)
    assert not any(Path(path).is_relative_to(ROOT) for path in paths)
    pip(started.folder, "--python", python, "check")

    code = "from importlib import resources; print(resources.files('perfbound') / 'campaigns' / 'test-function.toml')"
    campaign = run("python", "-c", code).out.strip()
    listed = run("perfbound", "systems").out
    assert {"segway", "test-function"} <= set(re.findall(r"^([\w-]+):", listed, re.MULTILINE))
    run("perfbound", "simulate", "segway", "--x", "5,0", "--horizon", "0.5", "--out", "one.mcap")
    run("perfbound", "run", campaign, "--out", "run", "--web")
    checks = json.loads(run("perfbound", "verify", "run", "--resimulate", "2", "--json").out)
    assert {each["status"] for each in checks["checks"]} <= {"passed", "skipped"}
    small = ("--functions", "1", "--seeds", "0", "--direct-seeds", "0", "--no-ours")
    run("perfbound", "reproduce", "paper", "--out", "paper", *small)
    assert (started.folder / "paper" / "table1.md").exists()
    # -m puts the working folder first on the path; the children of this one must not inherit that.
    run("python", "-m", "perfbound.orchestrator", "simulate", "test-function", "--x", "1,1", "--out", "two.mcap")

    assert not marker.exists(), marker.read_text()
    bitten = started.run(str(python), "-c", "import schemas", PYTHONPATH="")
    assert (bitten.code, marker.read_text()) == (1, "schemas\n")


def test_the_main_job_runs_from_the_wheel_and_harms_no_module_of_the_folder(linked: Path, started: Processes) -> None:
    check(linked, started)


def test_the_same_with_the_lock_installed_afresh(built: tuple[Path, Path], started: Processes, tmp_path: Path) -> None:
    """Downloads everything: minutes."""
    folder = tmp_path / "fresh"
    folder.mkdir()
    python = environment(folder / "venv")
    pip(folder, "--python", python, "install", "--require-hashes", "-r", LOCK)
    pip(folder, "--python", python, "install", "--no-deps", "--no-index", built[1])
    check(python, started)

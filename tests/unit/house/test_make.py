"""`make` with a Python that perfbound does not support, or that is not there: one line for every target."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.integration
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize("target", ["setup", "jax", "lint"])
def test_a_missing_python_is_named(target: str, tmp_path: Path) -> None:
    command = ("make", target, "PYTHON=python-of-nobody", f"VENV={tmp_path / 'venv'}")
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode
    first, *rest = ended.stderr.splitlines()
    assert first == "perfbound needs Python 3.11 3.12 3.13, and python-of-nobody is missing: choose one with PYTHON=..."
    assert all(line.startswith("make") for line in rest)
    assert not list(tmp_path.iterdir())


@pytest.mark.integration
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize(
    ("name", "chosen"), [("python3", "python3"), ("python3.12", "python3.12"), ("other", "python3")]
)
def test_make_takes_the_python_that_fits(name: str, chosen: str, tmp_path: Path) -> None:
    """As on a Debian whose only Python is `python3`; where none fits, the message names it."""
    for tool in ("sh", "echo", "make", "sed", "awk", "git"):
        (tmp_path / tool).symlink_to(str(shutil.which(tool)))
    (tmp_path / name).symlink_to(sys.executable)
    command = ["make", "--eval", "shown: ; @echo $(PYTHON)", "shown", f"VENV={tmp_path / 'venv'}"]
    ended = subprocess.run(command, cwd=ROOT, env={"PATH": str(tmp_path)}, capture_output=True, text=True, check=False)
    assert ended.stdout.split() == [chosen], ended.stderr


@pytest.mark.integration
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_the_rest_of_a_room_exists() -> None:
    """Every test in the table of rooms is there, and every room has a row."""
    text = (ROOT / "Makefile").read_text()
    table = dict(re.findall(r"^REST_(\S+) := (.+)$", text, re.MULTILINE))
    rooms = [path.parent for path in (ROOT / "orchestrator").glob("*/__init__.py")]
    rooms += [ROOT / each for each in ("schemas", "workers", "perfbound", "deploy", "docs")]
    assert set(table) == {str(each.relative_to(ROOT)) for each in rooms}
    for room, names in table.items():
        assert all((ROOT / "tests" / "end_to_end" / name).exists() for name in names.split()), room

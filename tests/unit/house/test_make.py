"""`make` with a Python that perfbound does not support, or that is not there: one line for every target."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize("target", ["setup", "mujoco", "lint"])
def test_a_missing_python_is_named(target: str, tmp_path: Path) -> None:
    command = ("make", target, "PYTHON=python-of-nobody", f"VENV={tmp_path / 'venv'}")
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode
    first, *rest = ended.stderr.splitlines()
    assert first == "perfbound needs Python 3.11 3.12 3.13, and python-of-nobody is missing: choose one with PYTHON=..."
    assert all(line.startswith("make") for line in rest)
    assert not list(tmp_path.iterdir())

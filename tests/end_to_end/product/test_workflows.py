"""The workflow files of deploy/ci: their own steps, in a folder with nothing but a project."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[3]
FILES = ("github-actions.yml", "gitlab-ci.yml")
CARS = (ROOT / "deploy" / "examples" / "cars" / "cars.py").read_text()
CAMPAIGN = """
horizon = 8
specification = "always (distance >= 2)"
max_tests = 100
recheck = 2
claims = [{ quantity = "failure_probability" }]
required_at_most = 0.1
system.python = "cars.py:cars"
space.gap = [20, 50]
space.speed = [10, 30]
"""


def steps(name: str) -> tuple[list[str], dict[str, str]]:
    """Return the shell lines of a workflow but the first, which installs, and its variables."""
    found: Any = yaml.safe_load((ROOT / "deploy" / "ci" / name).read_text())
    if "jobs" in found:
        lines = [step["run"] for step in found["jobs"]["campaign"]["steps"] if "run" in step]
        return lines[1:], found["env"]
    return found["perfbound"]["script"][1:], found["perfbound"]["variables"]


def job(name: str, project: Path) -> tuple[int, str]:
    """Run the steps of a workflow as its runner does, until one fails."""
    lines, variables = steps(name)
    summary = project / "summary.md"
    path = os.pathsep.join([str(Path(sys.executable).parent), "/usr/bin", "/bin"])
    environment = {"PATH": path, "HOME": str(project), "GITHUB_STEP_SUMMARY": str(summary), **variables}
    text = ""
    for line in lines:
        ended = subprocess.run(
            ["bash", "-eo", "pipefail", "-c", line],
            cwd=project,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        text += ended.stdout + ended.stderr
        if ended.returncode:
            return ended.returncode, text
    return 0, text


@pytest.mark.journey
@pytest.mark.parametrize("name", FILES)
def test_a_job_is_red_on_a_violated_campaign_and_green_on_the_mended_one(name: str, tmp_path: Path) -> None:
    for file, text in (("cars.toml", CAMPAIGN), ("policy.toml", "resimulated = 1\n")):
        (tmp_path / file).write_text(text)
    (tmp_path / "cars.py").write_text(CARS.replace("reaction=0.5", "reaction=3.0"))
    code, text = job(name, tmp_path)
    assert code == 3, text
    assert "VIOLATED" in text
    assert "GATE FAILED: 1 rule fails" in text
    (tmp_path / "cars.py").write_text(CARS)
    (tmp_path / "runs").rename(tmp_path / "of-the-other-version")  # another key, so that the cache has nothing
    code, text = job(name, tmp_path)
    assert code == 0, text
    assert "GATE PASSED" in text
    kept = (tmp_path / "runs" / "cars" / "certificate.json").stat().st_mtime_ns
    code, text = job(name, tmp_path)  # with what the cache has kept
    assert code == 0, text
    assert "finished already" in text
    assert (tmp_path / "runs" / "cars" / "certificate.json").stat().st_mtime_ns == kept

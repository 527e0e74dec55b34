"""`perfbound compare` on two versions of a function: its exit codes, kill -9 in between, and what verifies."""

import json
import re
import signal
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, recorded, wait_for

CARS = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.py"
CAMPAIGN = """
horizon = 8
specification = "always (distance >= 2)"
clip = [-20, 60]
system.python = "cars.py:cars"
space.gap = [5, 60]
space.speed = [15, 30]
falsify = {}
"""


def version(folder: Path, reaction: str) -> Path:
    """Write the cars with a reaction time, and their campaign."""
    folder.mkdir()
    (folder / "cars.py").write_text(CARS.read_text().replace("reaction=0.5", f"reaction={reaction}"))
    (folder / "cars.toml").write_text(CAMPAIGN)
    return folder / "cars.toml"


@pytest.mark.journey
def test_a_worse_version_fails_and_kill_9_changes_nothing(started: Processes) -> None:
    old, new, out = version(started.folder / "old", "0.5"), version(started.folder / "new", "0.7"), started.folder / "c"
    line = ("perfbound", "compare", old, new, "--out", out, "--pairs", "120", "--fail-on", "worse")
    killed = started.start(*line)
    wait_for(lambda: recorded(out / "a") > 20)
    killed.signal_group(signal.SIGKILL)
    killed.wait()
    assert not (out / "comparison.json").exists()
    ended = started.run(*line)
    assert ended.code == 3, ended.err
    assert re.search(r"mean robustness, m +\S+ +\S+ +-\S+ to -\S+ +WORSE", ended.out)
    assert "120 pairs of rollouts with the same starts and seeds" in ended.out
    found = json.loads((out / "comparison.json").read_text())
    assert (found["pairs"], found["verdict"]) == (120, "WORSE")
    assert "B IS WORSE" in (out / "comparison.html").read_text()
    again = started.run(*line[:-2])
    assert (again.code, again.out) == (0, ended.out)
    whole = started.run(*line[:5], started.folder / "whole", *line[6:-2])
    assert (whole.code, whole.out) == (0, ended.out), "without a kill"
    for side in ("a", "b"):
        assert started.run("perfbound", "verify", out / side).code == 0
        one, other = (started.folder / each / side / "certificate.json" for each in ("c", "whole"))
        assert one.read_bytes() == other.read_bytes()
    # Run directories stand for their campaigns, as long as their systems are those of then.
    same = started.run(
        *line[:2], out / "a", old, "--out", started.folder / "same", "--pairs", "40", "--equal", "mean=60"
    )
    assert same.code == 0, same.err
    assert "Both are one system, with the same sources." in same.out
    assert re.search(r"mean robustness, m .* EQUAL within 60 m", same.out)
    (started.folder / "old" / "cars.py").write_text(CARS.read_text().replace("reaction=0.5", "reaction=0.6"))
    changed = started.run(*line[:2], out / "a", new, "--out", started.folder / "changed")
    assert changed.code == 1
    assert "its system has other sources now" in changed.err
    refused = started.run(*line[:2], old, new, "--out", out, "--pairs", "9", "--seed", "4")
    assert refused.code == 1
    assert "the comparison here differs from this one" in refused.err
    assert started.run(*line[:-2], "--equal", "men=1").code == 2
    assert started.run(*line[:-2], "--worst-case").code == 2

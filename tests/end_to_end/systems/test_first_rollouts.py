"""A simulator at fault is one line before there is a run directory or a worker."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, processes

SYSTEM = """
import numpy as np
import perfbound as pb

@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"y": "m", "z": "m"}}, step=0.5)
def faulty(x, *, horizon):
    samples = np.full((round(horizon / 0.5) + 1, 2), 1.0 + x)
    return {returned}
"""
CAMPAIGN = """
horizon = 2.0
specification = "always (y >= 0)"
max_tests = 4
recheck = 0
problems = [{ name = "robustness", method = "sample" }]
[system]
python = "faulty.py:faulty"
[space]
x = [0, 1]
"""
TURNED = "samples.T"
OBJECTS = "np.where(samples > 0, None, samples)"
WIDE = "np.hstack([samples, samples])[:, :3]"


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path / "work") as found:
        yield found


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        pytest.param(TURNED, "an array (2, 5) of float64, its columns are y, z; return its", marks=pytest.mark.journey),
        (OBJECTS, "an array (5, 2) of object, is None (None at row 0, column 0); give real numbers"),
        (WIDE, "an array (5, 3) of float64, its columns are y, z; return (samples, 2)"),
    ],
    ids=["turned", "objects", "wide"],
)
def test_a_faulty_simulator_is_one_line_and_nothing_is_started(started: Processes, returned: str, words: str) -> None:
    (started.folder / "faulty.py").write_text(SYSTEM.format(returned=returned))
    (started.folder / "c.toml").write_text(CAMPAIGN)
    ended = started.run("perfbound", "run", "c.toml", "--out", "run")
    assert ended.code == 1
    assert ended.last_line.startswith("perfbound: c.toml: system.python: the first rollout of faulty fails, at x = ")
    assert words in ended.last_line
    assert "local worker" not in ended.err
    assert not (started.folder / "run").exists()

"""`perfbound export --regression` on a bad controller: its tests fail there, and pass on the fixed one."""

import csv
import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.end_to_end.processes import Ended, Processes

CARS = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.py"
CAMPAIGN = """
horizon = 8
specification = "always (distance >= 2)"
claims = [{ quantity = "failure_probability" }]
max_tests = 60
system.python = "cars.py:cars"
space.gap = [20, 50]
space.speed = [10, 30]
"""


def outcome(started: Processes, *chosen: str) -> Ended:
    return started.run("pytest", "-q", "-p", "no:cacheprovider", "regression", *chosen)


@pytest.mark.journey
def test_exported_tests_fail_on_the_bad_controller_and_pass_on_the_fixed_one(started: Processes) -> None:
    bad = CARS.read_text().replace("reaction=0.5", "reaction=1.2")
    (started.folder / "cars.py").write_text(bad)
    (started.folder / "cars.toml").write_text(CAMPAIGN)
    assert started.run("perfbound", "run", "cars.toml").code == 0
    line = ("perfbound", "export", "runs/cars", "--regression", "regression")
    assert started.run(*line).code == 2, "without a campaign file"
    exported = started.run(*line, "--campaign", "cars.toml", "--groups", "2")
    assert exported.code == 0, exported.err
    assert re.search(r"runs/cars: \d+ rollouts violate the specification; \d kinds? of failure", exported.out)
    rows = list(csv.DictReader((started.folder / "regression" / "cars_failures.csv").read_text().splitlines()))
    nearest = [row for row in rows if row["scenario"].endswith("nearest")]
    assert nearest
    for row in nearest:
        assert math.isclose(float(row["gap (m)"]), border(float(row["speed (m/s)"]), row), rel_tol=0.01), row
    failing = outcome(started)
    assert failing.code == 1
    assert f"{len(rows)} failed" in failing.out
    assert "1-worst: still failing: violates always distance >= 2 with robustness -" in failing.out
    draw = re.search(r"draw it: (perfbound simulate .*)", failing.out)
    assert draw
    drawn = started.run(*shlex.split(draw[1]))
    assert drawn.code == 0, drawn.err
    assert (started.folder / "1-worst.png").exists()

    (started.folder / "cars.py").write_text(bad.replace("reaction=1.2", "reaction=0.5"))
    fixed = outcome(started)
    assert fixed.code == 0, fixed.out
    assert f"{len(rows)} passed" in fixed.out

    # A nearest failure alone would call this fixed, too.
    (started.folder / "cars.py").write_text(bad.replace("reaction=1.2", "reaction=1.1"))
    partly = outcome(started, "-k", "worst")
    assert partly.code == 1
    assert "still failing" in partly.out

    (started.folder / "cars.py").write_text(bad.replace('"distance"', '"clearance"'))
    other = outcome(started, "-k", "1-worst")
    assert other.code == 1
    assert re.search(r"1-worst: changed: .*unknown column.*distance", other.out)
    (started.folder / "cars.py").write_text(bad.replace("(5, 60", "(49, 60"))
    narrower = outcome(started, "-k", "1-worst")
    assert re.search(r"1-worst: changed: gap = \S+ is not in \[49, 60\] m", narrower.out)
    (started.folder / "cars.py").write_text(
        bad.replace("    t = np", "    raise RuntimeError('sensor lost')\n    t = np")
    )
    (started.folder / "cars.py").write_text(bad.replace('(5, 60, unit="m")', '(5, 60, unit="km")'))
    in_km = outcome(started, "-k", "1-worst")
    assert "1-worst: changed: gap is in km now, and was in m" in in_km.out
    (started.folder / "cars.py").write_text(
        bad.replace("    t = np", "    raise RuntimeError('sensor lost')\n    t = np")
    )
    crashing = outcome(started, "-k", "1-worst")
    assert re.search(r"1-worst: changed: .*sensor lost", crashing.out)
    refused = started.run(*line, "--campaign", "cars.toml")
    assert refused.code == 1
    assert "cars.py is another one here" in refused.err


def border(speed: float, row: dict[str, str]) -> float:
    """Return the gap at which cars of this speed come as close as 2 m, by the steps of the simulator."""
    delay = 1.2 * np.random.default_rng(int(row["seed"])).uniform(0.8, 1.2)
    t = np.arange(0.0, 8.025, 0.05)
    ahead, follower = np.maximum(speed - 6 * t, 0), np.maximum(speed - 7 * np.maximum(t - delay, 0), 0)
    return 2 - float((0.05 * np.cumsum(ahead - follower)).min())

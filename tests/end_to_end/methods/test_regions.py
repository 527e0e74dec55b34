"""The regions of a plain Python function without noise: run, killed and resumed, verified, edited, reported."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from tests.end_to_end.processes import Ended, Processes, processes, recorded, wait_for
from tests.end_to_end.report.test_report import page_data

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "deploy" / "examples" / "cars" / "cars.py"
CAMPAIGN = """
horizon = 8.0
specification = "always (distance >= 2)"
regions = true
alpha = 0.5
max_tests = 100
rkhs_norm = 100
prior_mean = -10
noise_scale = 0
kernel = { length_scale = { gap = 30, speed = 20 } }
system = { python = "cars.py:cars", reaction = 1.2 }
space = { gap = { low = 5, high = 50 }, speed = { low = 10, high = 35 } }
"""
DECIDED = (60.2, 37.1, 2.7)
"""Shares of the starts in %: certified safe, certified unsafe, undecided."""
SHARES = re.compile(
    r"Certified safe: at least ([\d.]+) % of the starts; certified unsafe ([\d.]+) %; undecided ([\d.]+) %"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the function, whose reaction time is fixed here, and its campaign file."""
    found = tmp_path_factory.mktemp("regions")
    text = EXAMPLE.read_text().replace("speed, *, seed, horizon", "speed, *, horizon")
    fixed = text.replace("delay = reaction * np.random.default_rng(seed).uniform(0.8, 1.2)", "delay = reaction")
    assert "seed" not in fixed
    (found / "cars.py").write_text(fixed)
    (found / "safe.toml").write_text(CAMPAIGN)
    return found


@pytest.fixture(scope="module")
def ended(folder: Path) -> Ended:
    with processes(folder / "logs") as found:
        return found.run("perfbound", "run", folder / "safe.toml", "--out", folder / "run")


def test_the_output_has_the_shares(ended: Ended) -> None:
    assert ended.code == 0, ended.err
    found = SHARES.search(ended.out)
    assert found is not None
    # Other machines may decide a few boxes otherwise, and choose other tests after that.
    assert [float(share) for share in found.groups()] == pytest.approx(DECIDED, abs=1.0)


@pytest.mark.usefixtures("ended")
def test_every_certified_box_is_right(folder: Path) -> None:
    """The corners of the boxes, against the closed form of the least distance."""
    with (folder / "run" / "regions.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["gap low (m)", "gap high (m)", "speed low (m/s)", "speed high (m/s)", "status"]
    sums = {"safe": 0.0, "unsafe": 0.0, "undecided": 0.0}
    for *ends, status in rows:
        gap_low, gap_high, slow, fast = map(float, ends)
        sums[status] += (gap_high - gap_low) * (fast - slow) / (45 * 25)
        # The least distance grows with the gap and falls with the speed: one corner is the worst, one the best.
        if status == "safe":
            assert _margin(gap_low, fast) > -0.1
        elif status == "unsafe":
            assert _margin(gap_high, slow) < 0.1
    certificate = json.loads((folder / "run" / "certificate.json").read_text())["predicate"]
    assert sums == pytest.approx({name: certificate["regions"][name] for name in sums})
    assert [claim["quantity"] for claim in certificate["claims"]] == ["robustness", "safe_share"]


def _margin(gap: float, speed: float) -> float:
    """Return the least distance - 2 m by summing both speeds in steps of .05 s."""
    distance = least = gap
    for k in range(161):
        t = 0.05 * k
        distance += 0.05 * (max(speed - 6 * t, 0.0) - max(speed - 7 * max(t - 1.2, 0.0), 0.0))
        least = min(least, distance)
    return least - 2


@pytest.mark.usefixtures("ended")
def test_killed_and_resumed_it_is_the_same_and_verifies(started: Processes, folder: Path) -> None:
    directory = folder / "killed"
    first = started.start("perfbound", "run", folder / "safe.toml", "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 2)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    assert started.run("perfbound", "resume", directory).code == 0
    for name in ("certificate.json", "regions.csv"):
        assert (directory / name).read_bytes() == (folder / "run" / name).read_bytes()
    verified = started.run("perfbound", "verify", directory, "--json")
    assert verified.code == 0, verified.out
    statuses = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert statuses["regions"] == "passed"


@pytest.mark.usefixtures("ended")
def test_an_edited_table_is_refused(started: Processes, folder: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(folder / "run", tmp_path / "run"))
    table = run / "regions.csv"
    table.write_bytes(table.read_bytes().replace(b",undecided", b",safe", 1))
    refused = started.run("perfbound", "verify", run, "--json")
    assert refused.code == 1
    failed = [each for each in json.loads(refused.out)["checks"] if each["status"] == "failed"]
    assert [each["check"] for each in failed] == ["regions"]
    assert "not the one in the certificate" in failed[0]["detail"]


@pytest.mark.usefixtures("ended")
def test_the_report_has_the_map(started: Processes, folder: Path) -> None:
    shown = started.run("perfbound", "report", folder / "run")
    assert shown.code == 0, shown.err
    regions = page_data(folder / "run")["problems"][0]["regions"]
    (found,) = regions["slices"]
    assert (found["axes"], found["shape"]) == ([0, 1], [128, 128])
    assert set(found["cells"]) == {"0", "1", "2"}
    assert found["cells"].count("0") / 128**2 == pytest.approx(regions["safe"], abs=0.03)

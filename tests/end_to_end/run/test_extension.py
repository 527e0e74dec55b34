"""A campaign that ended by its budget and continues, with real processes."""

import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end import processes
from tests.end_to_end.processes import Processes, of_run, query, wait_for

CAMPAIGN = """
name = "short"
max_tests = 8
spot_check = 10
spot_check_followups = 5
recheck = 4
window = 2
clip = [-1, 2]
horizon = 0.3
specification = "always (value >= -0.65)"
system = { name = "test-function" }

[space]
z1 = { low = 0.0, high = 1.0, unit = "1" }
z2 = { low = 0.0, high = 1.0, unit = "1" }

[[problems]]
name = "robustness"
method = "rigorous"
alpha = 1e-6
rkhs_norm = 9.0
noise_scale = "derived"
kernel = { length_scale = 0.5 }
"""


@pytest.fixture(scope="module")
def ended_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that ended by its budget."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "short.toml").write_text(CAMPAIGN)
    with processes.processes(folder) as started:
        ended = started.run("perfbound", "run", folder / "short.toml", "--out", folder / "run")
        assert ended.code == 0, ended.err
    return folder / "run"


@pytest.fixture(scope="module")
def extended_once(ended_once: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same campaign, extended; it verifies."""
    folder = tmp_path_factory.mktemp("extended")
    directory = Path(shutil.copytree(ended_once, folder / "run"))
    with processes.processes(folder) as started:
        assert started.run("perfbound", "resume", directory, "--max-tests", "12").code == 0
        assert verify(started, directory)[0] == 0
    return directory


@pytest.fixture
def directory(ended_once: Path, started: Processes) -> Path:
    return Path(shutil.copytree(ended_once, started.folder / "run"))


def certificate(directory: Path) -> Certificate:
    return Certificate.model_validate_json((directory / "certificate.json").read_bytes())


def verify(started: Processes, directory: Path) -> tuple[int, str]:
    ended = started.run("perfbound", "verify", directory, "--resimulate", "2")
    return ended.code, ended.out


def test_extended_killed_resumed_and_verified(started: Processes, directory: Path, ended_once: Path) -> None:
    calm = Path(shutil.copytree(ended_once, started.folder / "calm"))
    ended = started.run("perfbound", "resume", calm, "--max-tests", "60")
    assert ended.code == 0, ended.err
    assert "extended to 60 tests" in ended.err

    process = started.start("perfbound", "resume", directory, "--max-tests", "60")
    first = sum(1 for _ in directory.rglob("*.mcap"))
    wait_for(lambda: sum(1 for _ in directory.rglob("*.mcap")) >= first + 5)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    wait_for(lambda: not of_run(directory))
    assert query(directory, "SELECT number, budgets FROM extensions") == [(1, '[["robustness",60]]')]
    assert not (directory / "certificate.json").exists()
    assert "of 60" in started.run("perfbound", "status", directory).out
    # Without the option as well: the extension is a fact of the campaign.
    assert started.run("perfbound", "resume", directory).code == 0

    for name in ("certificate.json", "manifest.sha256", "certificate-1.json", "manifest-1.sha256"):
        assert (directory / name).read_bytes() == (calm / name).read_bytes(), name
    assert (directory / "certificate-1.json").read_bytes() == (ended_once / "certificate.json").read_bytes()
    found = certificate(directory).predicate
    assert found.problems[0].tests == 60
    (line,) = [each for each in found.assumptions if each.id.startswith("extended_")]
    assert line.values == {"problem": "robustness", "after": 8, "max_tests": 60}
    code, out = verify(started, directory)
    assert code == 0, out
    assert "extended to 60" in out
    assert "of 60" in started.run("perfbound", "status", directory).out


def test_a_larger_budget_that_proves_nothing_is_refused(started: Processes, directory: Path) -> None:
    before = (directory / "certificate.json").read_bytes()
    ended = started.run("perfbound", "resume", directory, "--max-tests", "8")
    assert ended.code == 1
    assert "choose a larger number" in ended.last_line
    assert (directory / "certificate.json").read_bytes() == before


def without_line(directory: Path) -> None:
    found = certificate(directory)
    kept = tuple(each for each in found.predicate.assumptions if not each.id.startswith("extended_"))
    claims = tuple(
        claim.model_copy(update={"assumptions": tuple(n for n in claim.assumptions if not n.startswith("extended_"))})
        for claim in found.predicate.claims
    )
    predicate = found.predicate.model_copy(update={"assumptions": kept, "claims": claims})
    forged = found.model_copy(update={"predicate": predicate})
    (directory / "certificate.json").write_text(forged.to_json())


def without_new_checks(directory: Path) -> None:
    """Hide the checks after the extension, as if those of before had tested the bounds of now."""
    path = directory / "manifest.sha256"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if "check_b" not in line))


@pytest.mark.parametrize("forge", [without_line, without_new_checks])
def test_a_forged_extension_is_found(started: Processes, extended_once: Path, forge: Callable[[Path], Any]) -> None:
    directory = Path(shutil.copytree(extended_once, started.folder / "run"))
    forge(directory)
    code, out = verify(started, directory)
    assert code != 0, out

"""The systemd units: accepted by systemd, and with few rights."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.unit.deploy.files import UNITS, systemd_started, unit

NAMES = sorted(path.name for path in UNITS.glob("*.service"))
EXPOSURE = 15
"""Most that `systemd-analyze security` may find, of 100; it was 87 before the units were restricted."""
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="install systemd for systemd-analyze"
)


def installed(folder: Path, name: str) -> Path:
    """Write a unit with programs and folders that exist here in the place of ours."""
    text = (UNITS / name).read_text().replace("/opt/perfbound/.venv/bin/", "/bin/true ")
    path = folder / name.replace("@.", "@1.")
    path.write_text(text.replace("WorkingDirectory=/srv/perfbound", "WorkingDirectory=/"))
    return path


@pytest.mark.integration
@needs_systemd
@pytest.mark.parametrize("name", NAMES)
def test_a_unit_is_accepted_by_systemd(tmp_path: Path, name: str) -> None:
    command = ["systemd-analyze", "verify", "--man=no", str(installed(tmp_path, name))]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.integration
@needs_systemd
@pytest.mark.parametrize("name", NAMES)
def test_a_unit_has_few_rights(tmp_path: Path, name: str) -> None:
    path = installed(tmp_path, name)
    command = ["systemd-analyze", "security", "--offline=yes", "--no-pager", f"--threshold={EXPOSURE}", str(path)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout


@pytest.mark.parametrize("name", NAMES)
def test_a_key_is_handed_over_by_systemd(name: str) -> None:
    settings, started = unit(UNITS / name), systemd_started()[name]
    (credential,) = settings["LoadCredential"]
    label, _, path = credential.partition(":")
    options = started.options()
    assert options["tls_key"] == f"%d/{label}"
    folder = "/etc/perfbound"
    assert (options["tls_ca"], Path(path).parent) == (f"{folder}/ca.pem", Path(folder))
    assert path == options["tls_certificate"].removesuffix(".pem") + "-key.pem"


def test_units_wait_for_units_that_exist() -> None:
    for name in NAMES:
        text = (UNITS / name).read_text()
        for each in re.findall(r"perfbound[\w@-]*\.service", text):
            assert each in NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_service_is_started_again_however_often_it_has_ended(name: str) -> None:
    """By its limit systemd leaves one alone whose certificate ended ten seconds before it was renewed."""
    about, _, service = (UNITS / name).read_text().partition("[Service]")
    assert "\nStartLimitIntervalSec=0\n" in about
    assert "\nRestartSec=5\n" in service


def test_a_campaign_may_take_any_time_to_start() -> None:
    """It reads its whole database, and waits for its router; systemd would end it after 90 s, again and again."""
    settings = unit(UNITS / "perfbound.service")
    assert (settings["Type"], settings["TimeoutStartSec"]) == (["notify"], ["infinity"])

"""The container images, really built and run, on a base of Debian's packages: no registry of images is needed for it.

It takes minutes, root, buildah and debootstrap; each container runs in a change root, as the user of the image.
"""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.campaigns import with_few_checks
from tests.patience import PATIENCE

ROOT = Path(__file__).parents[3]
MISSING = [name for name in ("buildah", "debootstrap") if shutil.which(name) is None]
pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"install {' and '.join(MISSING)} to build the images"),
    pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a base image of Debian's packages"),
    pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="the images have Python 3.11"),
]
BASE = "localhost/python-of-debian"
PIP = [Path("/etc/pip.conf"), Path.home() / ".config/pip/pip.conf", Path("/etc/ssl/certs/ca-certificates.crt")]
"""How pip finds packages on this machine; mounted while an image is built, and in no image."""


class Builder:
    """buildah with a storage of its own."""

    def __init__(self, folder: Path) -> None:
        self._options = ["--root", str(folder / "root"), "--runroot", str(folder / "runroot")]

    def command(self, *words: str) -> list[str]:
        name, *rest = words
        return ["buildah", *self._options, name, *rest]

    def ask(self, *words: str) -> str:
        ended = subprocess.run(self.command(*words), capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr[-3000:]
        return ended.stdout.strip()

    def run(self, container: str, *words: str, mounts: tuple[str, ...] = ()) -> list[str]:
        """Return the command that runs words in a container, as its own user."""
        volumes = [f"--volume={mount}" for mount in mounts]
        return self.command("run", "--isolation=chroot", *volumes, container, "--", *words)


@pytest.fixture(scope="module")
def builder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Builder]:
    folder = tmp_path_factory.mktemp("images")
    found = Builder(folder)
    packages = "--include=python3,python3-venv,ca-certificates"
    subprocess.run(
        ["debootstrap", "--variant=minbase", packages, "bookworm", folder / "base"],
        stdout=subprocess.DEVNULL,
        check=True,
    )
    container = found.ask("from", "scratch")
    found.ask("add", container, str(folder / "base"), "/")
    found.ask("commit", "--rm", container, BASE)
    volumes = [f"--volume={path}:{path}:ro" for path in PIP if path.exists()]
    for target in ("orchestrator", "worker"):
        options = ("--isolation=chroot", "--layers", f"--build-arg=BASE={BASE}", *volumes)
        found.ask("bud", *options, "--target", target, "--tag", target, "--file", "deploy/Dockerfile", str(ROOT))
    try:
        yield found
    finally:
        subprocess.run(found.command("rm", "--all"), stdout=subprocess.DEVNULL, check=False)
        subprocess.run(found.command("rmi", "--all", "--force"), stdout=subprocess.DEVNULL, check=False)
        shutil.rmtree(folder, ignore_errors=True)  # gigabytes, which pytest would keep


def campaign_in(builder: Builder, container: str, words: tuple[str, ...], mounts: tuple[str, ...]) -> int:
    command = builder.run(container, *words, mounts=mounts)
    return subprocess.run(command, stdout=subprocess.DEVNULL, timeout=PATIENCE, check=False).returncode


def test_a_campaign_of_both_images(builder: Builder, tmp_path: Path) -> None:
    orchestrator, worker = builder.ask("from", "orchestrator"), builder.ask("from", "worker")
    runs, secret = tmp_path / "runs", "PERFBOUND_SECRET=0123456789abcdef0123456789abcdef"
    runs.mkdir()
    runs.chmod(0o777)
    campaign = with_few_checks(tmp_path / "campaign.toml", "test-function")
    mounts = (f"{campaign}:/campaign.toml:ro", f"{runs}:/runs")
    words = ("env", secret, "run-or-resume", "/campaign.toml", "/runs/a", "--listen", "tcp/127.0.0.1:17847")
    # A worker connects outwards, and waits for an orchestrator that is not there yet.
    served = subprocess.Popen(
        builder.run(worker, "env", secret, "perfbound-worker", "--connect", "tcp/127.0.0.1:17847", "--until-done")
    )
    try:
        first = subprocess.run(
            builder.run(orchestrator, *words, mounts=mounts),
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        assert first.returncode == 0, first.stderr
        certificate = (runs / "a" / "certificate.json").read_bytes()
        assert served.wait(PATIENCE) == 0
    finally:
        served.send_signal(signal.SIGTERM)
        served.wait(PATIENCE)
    assert campaign_in(builder, orchestrator, words, mounts) == 0
    assert (runs / "a" / "certificate.json").read_bytes() == certificate


@pytest.mark.parametrize("target", ["orchestrator", "worker"])
def test_an_image_has_no_root_no_pip_and_no_compiler(builder: Builder, target: str) -> None:
    container = builder.ask("from", target)
    ended = subprocess.run(
        builder.run(container, "sh", "-c", "id -u; command -v gcc cc; command -v pip; command -v perfbound-worker"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.stdout.split() == ["10001", "/opt/perfbound/bin/perfbound-worker"]


def test_the_image_of_a_worker_has_no_database(builder: Builder) -> None:
    container = builder.ask("from", "worker")
    code = "import importlib.util; print(*map(importlib.util.find_spec, ('sqlalchemy', 'sklearn', 'matplotlib')))"
    ended = subprocess.run(builder.run(container, "python", "-c", code), capture_output=True, text=True, check=False)
    assert ended.stdout == "None None None\n"

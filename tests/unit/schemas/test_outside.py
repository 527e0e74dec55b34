"""Files from outside: no pipe and no device is waited for, and nothing fills the memory."""

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.signing.keys import load_private, new_pair
from perfbound.orchestrator.certificate.signing.sign import sign_certificate
from perfbound.results import read_certificate, read_trajectory
from perfbound.schemas.errors import CampaignError, EvidenceError, LinkError, SignatureError
from perfbound.schemas.file.reader import load_campaign
from perfbound.schemas.link.configuration import connect_config, listen_config
from perfbound.schemas.outside import exposed, read_outside
from tests.fakes.certificates import Site
from tests.fakes.finished import a_list, finish, play


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("finished") / "run"
    finish(play(directory, a_list()), directory)
    return directory


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 10)
    assert read_outside(path, 10) == b"x" * 10
    with pytest.raises(OSError, match="more than 9 bytes"):
        read_outside(path, 9)
    os.truncate(path, 2**40)  # without a byte on the disk
    with pytest.raises(OSError, match="more than 10 bytes"):
        read_outside(path, 10)
    with pytest.raises(OSError, match="not a file"):
        read_outside(Path("/dev/zero"), 10)
    with pytest.raises(OSError, match=r"directory|not a file"):
        read_outside(tmp_path, 10)


@pytest.mark.parametrize("name", [files.MANIFEST, files.CERTIFICATE, files.ENVELOPE])
def test_sign_waits_for_no_pipe(tmp_path: Path, finished: Path, name: str) -> None:
    key = load_private(new_pair(tmp_path, "k").private)
    for each in (files.MANIFEST, files.CERTIFICATE):
        (tmp_path / each).write_bytes((finished / each).read_bytes())
    sign_certificate(tmp_path, key)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises((EvidenceError, SignatureError), match=f"{name}: not a file"):
        sign_certificate(tmp_path, key)


@pytest.mark.parametrize("read", [read_trajectory, read_certificate, load_private])
def test_no_reader_waits_for_a_pipe(tmp_path: Path, read: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises((OSError, SignatureError), match="not a file"):
        read(tmp_path / "pipe")


def test_a_file_of_starts_is_no_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "starts.csv")
    (tmp_path / "c.toml").write_text('[space]\nscenarios = "starts.csv"\n')
    with pytest.raises(CampaignError, match=r"starts\.csv: not a file"):
        load_campaign(tmp_path / "c.toml")


@pytest.mark.parametrize("mode", [0o666, 0o640, 0o604, 0o620])
def test_a_private_key_of_tls_is_private(tmp_path: Path, mode: int) -> None:
    tls = Site(tmp_path).tls("main", "orchestrator", "127.0.0.1")
    Path(tls.key).chmod(mode)
    message = re.escape(f"{tls.key}: others can read this private key; run `chmod 600` on it")
    with pytest.raises(LinkError, match=message):
        listen_config("tls/127.0.0.1:0", tls, insecure=False)
    with pytest.raises(LinkError, match=message):
        connect_config(["tls/127.0.0.1:1"], tls)
    Path(tls.key).chmod(0o600)
    assert "enable_mtls" in connect_config(["tls/127.0.0.1:1"], tls)


def test_the_owner_of_a_secret_decides() -> None:
    def status(mode: int, owner: int) -> os.stat_result:
        return os.stat_result((stat.S_IFREG | mode, 0, 0, 1, owner, 0, 0, 0, 0, 0))

    mine, root = os.geteuid(), os.geteuid() + 1
    assert not exposed(status(0o600, mine))
    assert exposed(status(0o640, mine))
    assert not exposed(status(0o640, root)), "through a group, on purpose"
    assert exposed(status(0o644, root))

"""`perfbound pki`: what it writes, what it refuses, and that nothing is ever half written or overwritten."""

import errno
import os
import re
import shlex
import signal
import stat
import subprocess
import sys
import threading
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from cryptography import x509
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat

from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.hosts.authority import Order, certificate_bytes, key_bytes, new_authority
from perfbound.orchestrator.hosts.pki import issue_files, issued, load_signer, pki_folder
from perfbound.schemas import atomic
from perfbound.schemas.errors import AuthorityError, PerfboundError
from perfbound.schemas.link.secret import user_secret
from perfbound.schemas.link.tls_files import check_host, check_link_files
from tests.facts import says
from tests.fakes.certificates import DAY, now
from tests.fakes.interleaving import meanwhile


def command(*words: object) -> Result:
    return CliRunner().invoke(cli, ["pki", *map(str, words)])


def done(*words: object) -> str:
    result = command(*words)
    assert result.exit_code == 0, (result.output, result.exception)
    return result.stdout


def refused(*words: object) -> str:
    result = command(*words)
    assert isinstance(result.exception, PerfboundError), result.output
    assert "\n" not in str(result.exception)
    return str(result.exception)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an authority, in the state folder of a user."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    done("init")
    return tmp_path / "state" / "perfbound" / "pki"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def contents(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


# init


def test_an_authority_is_for_its_owner_alone(home: Path) -> None:
    assert contents(home) == {"ca.pem", "ca-key.pem"}
    assert (mode(home), mode(home / "ca-key.pem"), mode(home / "ca.pem")) == (0o700, 0o600, 0o644)
    assert pki_folder() == home
    end = load_signer(home).certificate.not_valid_after_utc
    assert now() + 364 * DAY < end <= now() + 365 * DAY


def test_the_end_of_an_authority_is_printed(tmp_path: Path) -> None:
    folder = tmp_path / "my pki"
    out = done("init", "--folder", folder, "--days", 90)
    assert f"{now() + 90 * DAY:%Y-%m-%d}" in out
    assert f"perfbound pki issue --folder '{folder}' NAME" in out


def test_an_authority_is_never_overwritten(home: Path) -> None:
    before = (home / "ca-key.pem").read_bytes()
    assert says(refused("init"), "authority never overwritten certificates")
    assert (home / "ca-key.pem").read_bytes() == before
    assert os.listdir(home.parent) == ["pki"]


def test_an_authority_takes_an_empty_folder_and_no_other(tmp_path: Path) -> None:
    for name in ("empty", "full"):
        (tmp_path / name).mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "empty")
    for name in ("full", "file"):
        assert says(refused("init", "--folder", tmp_path / name), "new empty folder --folder")
    done("init", "--folder", tmp_path / "link")
    assert mode(tmp_path / "empty") == 0o700
    assert contents(tmp_path) == {"full/thesis.tex", "file", "empty/ca.pem", "empty/ca-key.pem"}


@pytest.mark.parametrize("there", [True, False])
def test_an_authority_is_in_no_git_work_tree(tmp_path: Path, there: bool) -> None:
    (tmp_path / "project" / ".git").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "project")
    if there:
        (tmp_path / "project" / "pki").mkdir()
    for folder in (tmp_path / "project" / "pki", tmp_path / "link" / "pki"):
        fault = refused("init", "--folder", folder)
        assert fault.startswith(f"{folder}: is in the git work tree {tmp_path / 'project'}, ")
        assert fault.endswith("choose a folder elsewhere with --folder")
    assert not contents(tmp_path)


def test_an_authority_without_a_place(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "pki"
    assert says(refused("init", "--folder", place), f"^{place}: --folder")


# issue


@pytest.mark.parametrize("role", ["worker", "orchestrator", "router"])
def test_three_files_open_a_link(home: Path, role: str) -> None:
    hosts = [] if role == "worker" else ["--host", "10.0.0.1"]
    done("issue", "a-1", f"--{role}", *hosts)
    there = home / "hosts" / "a-1"
    assert contents(there) == {"ca.pem", "a-1.pem", "a-1-key.pem"}
    assert (mode(there), mode(there / "a-1-key.pem")) == (0o700, 0o600)
    files = (str(there / name) for name in ("ca.pem", "a-1.pem", "a-1-key.pem"))
    check_link_files(*files, listens=role != "worker", connects=True)
    if hosts:
        check_host(str(there / "a-1.pem"), "10.0.0.1")


def test_the_commands_can_be_copied(home: Path, tmp_path: Path) -> None:
    """Also where a folder has a name that a shell would take apart."""
    done("issue", "node-1", "--worker")
    done("issue", "main", "--orchestrator")
    out = tmp_path / "a b; touch hacked"
    lines = [shlex.split(line) for line in done("issue", "gate", "--router", "--out", out).splitlines()]
    assert ["scp", "-rp", str(out), "HOST:"] in lines
    (line,) = (line for line in lines if line[:2] == ["perfbound", "router"])
    assert line[-4:] == ["--allow-orchestrator", "main", "--allow", "node-1"]
    files = [(tmp_path / line[line.index(option) + 1]) for option in ("--tls-ca", "--tls-certificate", "--tls-key")]
    assert all(file.is_file() for file in files), "as copied into the home directory of a host"
    second = shlex.split(done("issue", "gate2", "--router", "--host", "fe80::1"))
    assert second[-6:] == ["--allow-orchestrator", "main", "--allow-router", "gate", "--allow", "node-1"]
    assert "tls/[::]:7447" in second
    listed = done("list")
    for name, other in (("gate", "gate2"), ("gate2", "gate")):
        assert says(listed, f"router {name}: --allow-orchestrator main --allow-router {other} --allow node-1")
    worker = done("issue", "node-2", "--worker")
    assert says(worker, "perfbound-worker --connect 'tls/[fe80::1]:7447' --tls-ca node-2/ca.pem")
    assert f"ends at {now() + 30 * DAY:%Y-%m-%d}" in worker


def test_a_certificate_is_never_overwritten_and_renewed_elsewhere(home: Path, tmp_path: Path) -> None:
    done("issue", "node-1", "--worker", "--days", 3)
    before = {name: (home / "hosts" / name).read_bytes() for name in contents(home / "hosts")}
    fault = refused("issue", "node-1", "--worker")
    assert says(fault, f"^{home / 'hosts' / 'node-1'}: certificate never overwritten")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    assert "exists already" in refused("issue", "node-1", "--worker", "--out", tmp_path / "mine")
    assert len(contents(home / "issued")) == 1, "what was refused is not listed"
    done("issue", "node-1", "--worker", "--out", tmp_path / "new")
    assert {name: (home / "hosts" / name).read_bytes() for name in contents(home / "hosts")} == before
    old, new = (
        x509.load_pem_x509_certificate((folder / "node-1.pem").read_bytes())
        for folder in (home / "hosts" / "node-1", tmp_path / "new")
    )
    assert old.serial_number != new.serial_number
    assert old.public_key() != new.public_key()
    assert len(contents(home / "issued")) == 2


def test_names_that_cannot_go_together_are_refused(home: Path) -> None:
    done("issue", "node-1", "--worker")
    assert says(refused("issue", "node-1-2", "--worker"), "worker 'node-1'")
    assert "is the name of an issued worker" in refused("issue", "node-1", "--router")
    assert "no name of a worker" in refused("issue", "node.2", "--worker")
    assert "leave --host out" in refused("issue", "node-2", "--worker", "--host", "a.example")
    assert contents(home / "hosts") == {f"node-1/{name}" for name in ("ca.pem", "node-1.pem", "node-1-key.pem")}


def test_a_name_is_free_again_when_its_certificates_have_ended(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perfbound.orchestrator.hosts.pki._now", lambda: now() - 2 * DAY)
    done("issue", "node-1", "--worker", "--days", 1)
    monkeypatch.undo()
    done("issue", "node-1-2", "--worker", "--folder", home)
    listed = done("list", "--folder", home)
    assert re.search(r"worker +node-1 +ended at ", listed)
    assert "options" not in listed, "there is no router"
    assert "'node-1': is not apart" in refused("issue", "node-1", "--worker", "--folder", home, "--out", tmp_path / "x")


def test_a_name_keeps_its_role_when_its_certificates_have_ended(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A router that still lists it as an orchestrator would take the worker for one."""
    monkeypatch.setattr("perfbound.orchestrator.hosts.pki._now", lambda: now() - 2 * DAY)
    done("issue", "main", "--orchestrator", "--days", 1)
    monkeypatch.undo()
    assert says(refused("issue", "main", "--worker", "--folder", home), "'main': orchestrator")
    done("issue", "main", "--orchestrator", "--folder", home, "--out", tmp_path / "new")


@pytest.mark.parametrize("given", [True, False])
def test_the_folder_of_the_secret_is_for_its_user_alone_whoever_makes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: bool
) -> None:
    """The authority comes first, with a umask by which the group may write."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "state" / "perfbound"
    before = os.umask(0o002)
    try:
        done("init", *(("--folder", folder / "pki") if given else ()))
        assert mode(folder) == 0o700
        assert user_secret()
    finally:
        os.umask(before)
    done("issue", "node-1", "--worker")
    folder.chmod(0o775)
    assert refused("issue", "node-2", "--worker").startswith(f"{folder}: others could replace")
    assert "run `chmod 700` on it" in refused("issue", "node-2", "--worker")


def test_of_two_names_that_cannot_go_together_one_is_issued_also_at_the_same_time(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads, refusals = list[threading.Thread](), list[AuthorityError]()

    def issue_other() -> None:
        try:
            issue_files(home, Order("node-1-2", "worker"), 3, None)
        except AuthorityError as error:
            refusals.append(error)

    def instant() -> datetime:
        """The first name has been compared with those that are issued."""
        if not threads:
            threads.append(threading.current_thread())
            threads[0] = meanwhile(issue_other)
        return now()

    monkeypatch.setattr("perfbound.orchestrator.hosts.pki._now", instant)
    issue_files(home, Order("node-1", "worker"), 3, None)
    threads[0].join()
    assert ([each.order.name for each in issued(home)], len(refusals)) == (["node-1"], 1)


def test_a_private_key_in_a_git_work_tree_is_warned_about(home: Path, tmp_path: Path) -> None:
    (tmp_path / "project" / ".git").mkdir(parents=True)
    result = command("issue", "node-1", "--worker", "--out", tmp_path / "project" / "node-1")
    assert result.exit_code == 0
    assert result.stderr.startswith(f"perfbound: {tmp_path / 'project' / 'node-1'}: is in the git work tree ")


def test_an_authority_that_has_come_into_a_git_work_tree_is_warned_about(home: Path, tmp_path: Path) -> None:
    """It was made outside of any; then the folder around it was put under version control."""
    (home.parent / ".git").mkdir()
    result = command("issue", "node-1", "--worker", "--out", tmp_path / "elsewhere")
    assert result.exit_code == 0
    assert says(result.stderr, f"^perfbound: {home}: {home.parent} authority's key")


def test_wrong_usage(home: Path) -> None:
    assert command("issue", "node-1").exit_code == 2
    for days in (0, 398):
        assert command("issue", "node-1", "--worker", "--days", days).exit_code == 2
    assert "itself ends at" in refused("issue", "node-1", "--worker", "--days", 366)
    assert contents(home) == {"ca.pem", "ca-key.pem"}


# A damaged or exposed authority


def test_there_is_no_authority(tmp_path: Path) -> None:
    for words in (["list"], ["issue", "node-1", "--worker"]):
        fault = refused(*words, "--folder", tmp_path / "pki")
        assert says(fault, f"^{tmp_path / 'pki'}: `perfbound pki init`")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["ca.pem", "ca-key.pem"])
@pytest.mark.parametrize("content", [b"", b"garbage", b"\xff" * 2000, b"x" * 2_000_000])
def test_a_damaged_authority_issues_nothing(home: Path, name: str, content: bytes) -> None:
    (home / name).write_bytes(content)
    fault = refused("issue", "node-1", "--worker")
    assert str(home / name) in fault
    assert contents(home) == {"ca.pem", "ca-key.pem"}


def test_the_key_of_another_authority(home: Path) -> None:
    (home / "ca-key.pem").write_bytes(key_bytes(new_authority(now(), 9).key))
    assert f"{home / 'ca-key.pem'}: not the private key of {home / 'ca.pem'}" in refused("issue", "n", "--worker")


def test_a_key_with_a_password(home: Path) -> None:
    cipher = BestAvailableEncryption(b"secret")
    locked = load_signer(home).key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, cipher)
    (home / "ca-key.pem").write_bytes(locked)
    assert "not the private key of" in refused("issue", "n", "--worker")


def test_an_authority_that_others_could_read_or_replace(home: Path) -> None:
    (home / "ca-key.pem").chmod(0o640)
    assert says(refused("issue", "n", "--worker"), "private `chmod 600`")
    (home / "ca-key.pem").chmod(0o600)
    for writable in (0o720, 0o702):
        home.chmod(writable)
        assert says(refused("issue", "n", "--worker"), "authority `chmod 700`")
    home.chmod(0o755)
    done("issue", "n", "--worker")


@pytest.mark.parametrize(
    ("begun", "words"), [(-99, "this certificate ended at"), (9, "this certificate is valid from")]
)
def test_an_authority_out_of_its_time(home: Path, begun: int, words: str) -> None:
    """It has ended, or the clock is far off."""
    signer = new_authority(now() + begun * DAY, 9)
    (home / "ca.pem").write_bytes(certificate_bytes(signer.certificate))
    (home / "ca-key.pem").write_bytes(key_bytes(signer.key))
    fault = refused("issue", "n", "--worker")
    assert fault.startswith(f"{home / 'ca.pem'}: {words}")
    assert "the clock of this machine shows" in fault
    assert "pki issue" not in fault


def test_a_folder_of_issued_certificates_that_is_none(home: Path) -> None:
    (home / "issued").touch()
    fault = refused("issue", "n", "--worker")
    assert says(fault, f"^{home / 'issued'}: written File exists certificate folder")
    assert "hosts" not in os.listdir(home)


def test_a_foreign_file_among_the_issued_certificates(home: Path) -> None:
    done("issue", "n", "--worker")
    (home / "issued" / "x.pem").write_text("garbage")
    assert says(refused("list"), f"^{home / 'issued' / 'x.pem'}: certificate file")


# The disk, and kills


def test_an_authority_that_cannot_be_written(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a folder of root, or on a disk that is mounted read-only."""

    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "mkdir", read_only)
    assert says(refused("issue", "n", "--worker"), f"^{home / 'issued'}: written Read-only certificate folder")


@pytest.mark.parametrize("room", range(4))
def test_a_full_disk_leaves_nothing(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    left, create = [room], atomic._create

    def filling(path: Path, data: bytes, file_mode: int) -> None:
        if not left[0]:
            path.write_bytes(data[:3])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        left[0] -= 1
        create(path, data, file_mode)

    monkeypatch.setattr(atomic, "_create", filling)
    assert says(refused("issue", "n", "--worker", "--out", tmp_path / "out"), "written No space left")
    assert contents(home) == {"ca.pem", "ca-key.pem"}
    assert not (tmp_path / "out").exists()
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".partial")]


KILLED = """
import os, signal, sys
from perfbound.schemas import atomic
left, fsync = int(sys.argv.pop(1)), os.fsync

def killed(descriptor):
    global left
    left -= 1
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    fsync(descriptor)

os.fsync = killed
from perfbound.orchestrator.cli import main
main()
"""


@pytest.mark.rest
@pytest.mark.integration
@pytest.mark.parametrize("words", [["init"], ["issue", "node-1", "--worker"]])
def test_a_kill_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    home, made = tmp_path / "perfbound" / "pki", {"ca.pem", "ca-key.pem"}
    if words != ["init"]:
        done("init")
        home, made = home / "hosts" / "node-1", {"ca.pem", "node-1.pem", "node-1-key.pem"}
    for number in range(1, 30):
        line = [sys.executable, "-P", "-c", KILLED, str(number), "pki", *words]
        code = subprocess.run(line, capture_output=True, check=False).returncode
        if home.exists():
            assert contents(home) == made
            break
        assert code == -signal.SIGKILL
    assert number > 3, "it was killed on the way"
    with pytest.raises(AuthorityError, match="exists already"):
        raise command(*words).exception or AssertionError

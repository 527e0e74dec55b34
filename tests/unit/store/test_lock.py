"""The lock of a run directory: of a folder and of a file in it, which NFS shares between nodes."""

import contextlib
import errno
import fcntl
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from perfbound.orchestrator.run.directory import claimed
from perfbound.orchestrator.run.outbox import forget
from perfbound.orchestrator.store.files import sweep
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.lock import LOCK_FILE, campaign_lock, is_held
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import PerfboundError
from tests.unit.store.test_journal import FACTS, a_config, a_header

RUNNING = "another orchestrator is running this campaign"


@contextmanager
def locked(path: Path, flags: int = os.O_RDONLY, kind: int = fcntl.LOCK_EX) -> Iterator[int]:
    """Lock a file or folder as another process: the lock belongs to what was opened."""
    descriptor = os.open(path, flags)
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
        yield descriptor
    finally:
        os.close(descriptor)


@pytest.mark.integration
def test_an_orchestrator_on_another_node_is_seen_by_the_lock_of_the_file_alone(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).touch()
    with locked(tmp_path / LOCK_FILE, os.O_RDWR):
        assert is_held(tmp_path)
        with pytest.raises(PerfboundError, match=RUNNING), campaign_lock(tmp_path):
            pass
    assert not is_held(tmp_path)
    with campaign_lock(tmp_path):
        pass


@pytest.mark.integration
def test_a_lock_of_the_folder_alone_keeps_others_out(tmp_path: Path) -> None:
    with locked(tmp_path):
        assert is_held(tmp_path)
        with pytest.raises(PerfboundError, match=RUNNING), campaign_lock(tmp_path):
            pass
        assert not (tmp_path / LOCK_FILE).exists(), "the folder is locked first"


def test_both_locks_are_held_as_a_lock_file_may_be_removed_and_a_folder_is_locked_on_one_node(tmp_path: Path) -> None:
    with campaign_lock(tmp_path):
        for path in (tmp_path, tmp_path / LOCK_FILE):
            with pytest.raises(BlockingIOError), locked(path, kind=fcntl.LOCK_SH):
                pass
    for path in (tmp_path, tmp_path / LOCK_FILE):
        with locked(path, kind=fcntl.LOCK_EX):
            pass


def test_the_file_is_opened_for_writing_or_nfs_gives_no_exclusive_lock(tmp_path: Path) -> None:
    with campaign_lock(tmp_path) as held:
        assert fcntl.fcntl(held.descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDWR
        assert not os.get_inheritable(held.descriptor)


def test_the_file_comes_from_an_orchestrator_alone(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    assert list(tmp_path.iterdir()) == [], "a reader makes nothing"
    with campaign_lock(tmp_path):
        assert is_held(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]
    inode = (tmp_path / LOCK_FILE).stat().st_ino
    with campaign_lock(tmp_path):
        assert (tmp_path / LOCK_FILE).stat().st_ino == inode, "it is never replaced"


def test_a_reader_changes_nothing_in_a_directory_that_it_may_only_read(tmp_path: Path) -> None:
    with campaign_lock(tmp_path):
        pass
    before = (tmp_path / LOCK_FILE).stat()
    (tmp_path / LOCK_FILE).chmod(0o444)
    tmp_path.chmod(0o555)
    opened: list[int] = []
    real = os.open

    def noted(path: "str | Path", flags: int, mode: int = 0o777) -> int:
        opened.append(flags)
        return real(path, flags, mode)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", noted)
        assert not is_held(tmp_path)
    assert len(opened) == 2
    assert not any(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) for flags in opened)
    assert (tmp_path / LOCK_FILE).stat().st_mtime_ns == before.st_mtime_ns
    tmp_path.chmod(0o755)


@pytest.mark.parametrize("name", [".", LOCK_FILE])
def test_the_probe_of_a_reader_does_not_keep_an_orchestrator_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / LOCK_FILE).touch()
    probe = contextlib.ExitStack()
    probe.enter_context(locked(tmp_path / name, kind=fcntl.LOCK_SH))
    monkeypatch.setattr("perfbound.orchestrator.store.lock.time.sleep", lambda _: probe.close())
    with campaign_lock(tmp_path):
        pass


@pytest.mark.integration
def test_a_lock_on_a_file_that_was_replaced_before_it_was_locked_counts_for_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, real, inodes = tmp_path / LOCK_FILE, fcntl.flock, list[int]()
    path.touch()

    def late(descriptor: int, kind: int) -> None:
        found = os.fstat(descriptor).st_ino
        if found == path.stat().st_ino and not inodes:
            inodes.append(found)
            path.rename(tmp_path / "gone")  # between open and lock; the inode is not used again
            path.touch()
        real(descriptor, kind)

    monkeypatch.setattr(fcntl, "flock", late)
    with campaign_lock(tmp_path) as held:
        assert os.fstat(held.descriptor).st_ino == path.stat().st_ino != inodes[0]
        with pytest.raises(BlockingIOError), locked(path, os.O_RDWR):
            pass


def _symlink(path: Path) -> None:
    (path.parent / "victim").write_bytes(b"")
    path.symlink_to(path.parent / "victim")


def _dangling(path: Path) -> None:
    path.symlink_to(path.parent / "victim")


def _hard_link(path: Path) -> None:
    (path.parent / "victim").write_bytes(b"precious")
    path.hardlink_to(path.parent / "victim")


STRANGE: list[Callable[[Path], object]] = [
    _symlink,
    _dangling,
    _hard_link,
    os.mkfifo,
    os.mkdir,
    lambda path: path.write_bytes(b"0" * 33),
    lambda path: path.write_bytes(b"\xff" * 32),
]


@pytest.mark.parametrize("make", STRANGE)
def test_something_else_in_the_place_of_the_file_is_refused_and_never_followed(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    path, victim = tmp_path / LOCK_FILE, tmp_path / "victim"
    make(path)
    before = victim.read_bytes() if victim.exists() else None
    assert not is_held(tmp_path), "no orchestrator can hold it"
    line = f"^{path}: not a lock file of perfbound; remove it"
    with pytest.raises(PerfboundError, match=line), campaign_lock(tmp_path):
        pass
    assert (victim.read_bytes() if victim.exists() else None) == before
    assert not is_held(tmp_path), "the folder is released"


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
@pytest.mark.parametrize("name", [".", LOCK_FILE])
def test_a_file_system_without_locks_is_named_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, name: str
) -> None:
    (tmp_path / LOCK_FILE).touch()
    real, place = fcntl.flock, (tmp_path / name).stat().st_ino

    def none(descriptor: int, kind: int) -> None:
        if os.fstat(descriptor).st_ino == place:
            raise OSError(code, os.strerror(code))
        real(descriptor, kind)

    monkeypatch.setattr(fcntl, "flock", none)
    line = f"^{tmp_path / name}: the file system has no locks .*; mount it with locks, or choose a directory"
    with pytest.raises(PerfboundError, match=line), campaign_lock(tmp_path):
        pass
    with pytest.raises(PerfboundError, match=line):
        is_held(tmp_path)


# While it is held


def of_another_orchestrator(path: Path) -> None:
    path.write_bytes(b"0" * 32)  # it had the directory while this node was cut off, and has ended


def removed(path: Path) -> None:
    path.unlink()


def replaced(path: Path) -> None:
    path.rename(path.with_name("gone"))
    path.write_bytes(path.with_name("gone").read_bytes())


LOST = "this orchestrator has lost its lock, and another one may have continued the campaign"
REPLACED = "removed or replaced while the campaign was running"


@pytest.mark.parametrize(("lose", "line"), [(of_another_orchestrator, LOST), (removed, REPLACED), (replaced, REPLACED)])
def test_nothing_is_written_after_the_lock_is_lost(tmp_path: Path, lose: Callable[[Path], None], line: str) -> None:
    with campaign_lock(tmp_path) as held, closing(Journal.create(tmp_path, a_header(), held=held)) as journal:
        with journal.transaction():
            journal.add(FACTS[0])
        journal.check_place()
        lose(tmp_path / LOCK_FILE)
        with pytest.raises(PerfboundError, match=line), journal.transaction():
            journal.add(FACTS[1])
        with pytest.raises(PerfboundError, match=line):
            journal.check_place()
    with closing(Journal.open(tmp_path)) as journal:
        assert list(journal.facts()) == FACTS[:1]


@pytest.mark.parametrize("lost", [True, False])
def test_the_log_is_folded_into_the_database_under_the_lock_alone(tmp_path: Path, lost: bool) -> None:
    """Without the lock, the log may be another orchestrator's."""
    with campaign_lock(tmp_path) as held:
        journal = Journal.create(tmp_path, a_header(), held=held)
        with journal.transaction():
            journal.add(FACTS[0])
        with closing(sqlite3.connect(tmp_path / DATABASE)) as reader:  # SQLite folds at the end of the last connection
            reader.execute("SELECT * FROM campaign").fetchall()
            if lost:
                of_another_orchestrator(tmp_path / LOCK_FILE)
            journal.close()
            assert bool((tmp_path / f"{DATABASE}-wal").stat().st_size) == lost


@pytest.mark.parametrize("code", [errno.EAGAIN, errno.EIO])
def test_the_answer_of_a_server_that_gave_the_lock_away_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """Measured with NFS 4.2: EAGAIN while another node has the lock, EIO of a read after that."""
    with campaign_lock(tmp_path) as held:
        held.check()

        def refuse(*_: object) -> None:
            raise OSError(code, os.strerror(code))

        monkeypatch.setattr(*((fcntl, "flock", refuse) if code == errno.EAGAIN else (os, "pread", refuse)))
        with pytest.raises(PerfboundError, match=f"^{tmp_path / LOCK_FILE}: {LOST}"):
            held.check()


def test_a_reopened_campaign_writes_under_its_lock(tmp_path: Path) -> None:
    Journal.create(tmp_path, a_header()).close()
    with campaign_lock(tmp_path) as held, closing(Journal.open(tmp_path, held=held)) as journal:
        of_another_orchestrator(tmp_path / LOCK_FILE)
        with pytest.raises(PerfboundError, match=LOST), journal.transaction():
            journal.add(FACTS[0])


def test_a_check_keeps_the_lock(tmp_path: Path) -> None:
    with campaign_lock(tmp_path) as held:
        for _ in range(3):
            held.check()
            assert is_held(tmp_path)
        with pytest.raises(BlockingIOError), locked(tmp_path / LOCK_FILE, os.O_RDWR):
            pass


CHILD = """
import os, sys, time
from pathlib import Path
from perfbound.orchestrator.store.lock import campaign_lock
import subprocess
with campaign_lock(Path(sys.argv[1])):
    child = subprocess.Popen(["sleep", "1000"], stdout=subprocess.DEVNULL, close_fds=False)
    print(child.pid, flush=True)
    os.kill(os.getpid(), 9)
"""


@pytest.mark.integration
def test_a_program_that_outlives_a_killed_orchestrator_keeps_no_lock(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", CHILD, str(tmp_path)], stdout=subprocess.PIPE, check=False)
    child = int(ended.stdout)
    try:
        os.kill(child, 0)  # it lives
        assert not is_held(tmp_path)
        with campaign_lock(tmp_path):
            pass
    finally:
        os.kill(child, signal.SIGKILL)


# The directory


@pytest.mark.parametrize("there", [True, False])
def test_a_start_that_fails_leaves_no_lock_file(tmp_path: Path, there: bool) -> None:
    directory = tmp_path / "run"
    if there:
        directory.mkdir()
    with contextlib.suppress(RuntimeError), claimed(directory, a_config()):
        assert (directory / LOCK_FILE).exists()
        raise RuntimeError
    assert [path.name for path in tmp_path.rglob("*")] == (["run"] if there else [])


def test_a_start_that_was_killed_leaves_a_lock_file_that_hinders_no_other_one(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).write_bytes(b"0" * 32)
    with claimed(tmp_path, a_config()):
        Journal.create(tmp_path, a_header()).close()
    assert (tmp_path / LOCK_FILE).exists(), "the directory has a campaign, and keeps its lock file"


def test_a_start_that_has_lost_its_lock_removes_no_file_of_another_one(tmp_path: Path) -> None:
    with contextlib.suppress(RuntimeError), claimed(tmp_path, a_config()):
        replaced(tmp_path / LOCK_FILE)
        raise RuntimeError
    assert (tmp_path / LOCK_FILE).exists()


def test_a_directory_with_files_of_others_gets_none(tmp_path: Path) -> None:
    (tmp_path / "mine").touch()
    with pytest.raises(PerfboundError, match="exists and is not empty"), claimed(tmp_path, a_config()):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_what_removes_leftovers_and_keys_keeps_the_lock_file(tmp_path: Path) -> None:
    with campaign_lock(tmp_path) as held:
        sweep(tmp_path, frozenset())
        forget(tmp_path)
        held.check()


def test_a_reader_that_probes_the_lock_is_no_orchestrator_for_another_reader(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).touch()
    for place, flags in ((tmp_path, os.O_RDONLY | os.O_DIRECTORY), (tmp_path / LOCK_FILE, os.O_RDONLY)):
        other = os.open(place, flags)
        try:
            fcntl.flock(other, fcntl.LOCK_SH)
            assert not is_held(tmp_path)
        finally:
            os.close(other)

"""Which of the files that appear during a rollout are its own."""

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.workers.check_system import mark_files, own_entries
from perfbound.workers.opened import Opened

LIBC = ctypes.CDLL(None)


@pytest.fixture
def umask() -> Iterator[None]:
    """The usual one of a user, for this test alone."""
    before = os.umask(0o022)
    yield
    os.umask(before)


def made_in_c(path: Path) -> str:
    """Make a file as a library in C does, of which Python hears nothing."""
    LIBC.close(LIBC.creat(os.fsencode(path), 0o666))
    return path.name


@pytest.mark.usefixtures("umask")
def test_those_of_another_program_are_not(tmp_path: Path) -> None:
    opened = Opened(None)
    other = made_in_c(tmp_path / "backup.csv")
    mark_files()
    found = [made_in_c(tmp_path / "log.csv"), "python.csv", "folder"]
    (tmp_path / "python.csv").write_text("1")
    (tmp_path / "python.csv").chmod(0o644)
    LIBC.mkdir(os.fsencode(tmp_path / "folder"), 0o777)
    assert own_entries(str(tmp_path), [other, *found], opened) == tuple(found)


@pytest.mark.usefixtures("umask")
def test_the_temporary_directory_is_that_of_the_check_alone(tmp_path: Path) -> None:
    names = ["$TMPDIR/cache", "gone.csv"]
    assert own_entries(str(tmp_path), names, Opened(None)) == ("$TMPDIR/cache",)


def test_a_strict_umask_stays_as_strict(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        mark_files()
        name = made_in_c(tmp_path / "private.csv")
    finally:
        os.umask(before)
    assert (tmp_path / name).stat().st_mode & 0o777 == 0o600
    assert own_entries(str(tmp_path), [name], Opened(None)) == (), "nobody knows whose it is"
